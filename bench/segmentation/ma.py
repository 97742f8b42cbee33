"""Ma's table on left-atrium MRI: 16 ways to tell a V-Net of distance maps, and Juhl's regression, by one protocol.

    python -m sdm.bench.segmentation.ma run --data DIR/la --budget-s 400     # goes on where it was; all GPUs
    python -m sdm.bench.segmentation.ma table                                # the table from the logs
    python -m sdm.bench.segmentation.ma run --data DIR/la --keep FOLDER --ensemble  # and each row's mean over seeds
    python -m sdm.bench.segmentation.ma ensemble --data DIR/la --keep FOLDER        # that alone, of kept networks
    python -m sdm.bench.segmentation.ma ensemble --data DIR/la --keep FINE --beside COARSE --logs M.jsonl  # and others

J. Ma et al., "How distance transform maps boost segmentation CNNs: an empirical study", MIDL 2020. DIR/la has `train`
and `val` with HDF5 files (data sets image, label); near twins of validation cases are not trained on. Every row has
the same network, patches, optimiser, schedule and number of steps; nothing is chosen by the validation cases but what
is said in the log's settings. Distances are in voxels, as in the paper. A log holds the scores of every case, as
predicted and of the largest connected component. An ensemble averages what the networks of a row say, over its seeds,
and has a log of its own, METHOD-ensemble. Its networks bring their settings; --methods, --seeds, --cases, --window and
--stride are for the command to say. What is not said is as in the table that is kept in bench/results. With --beside
the networks of a row in other folders, whose settings may be others (voxels four times as large), are averaged with
those in --keep; the logs need their own file. A trial of the protocol has --logs FILE.jsonl/NAME, one of several in a
file.

What differs from the public code of the paper, because that is wrong or was not needed: distance maps are those of
whole cases (--targets patch: of each patch, as there); the reconstruction branch is a decoder of its own; the Hausdorff
loss measures inside and outside (method hausdorff-foreground: as there); surface distances go both ways; an empty
prediction counts as a failure; the learning rate follows one schedule; there are far fewer steps.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common.checkout import data_folder, results_folder
from sdm.bench.common.machine import describe
from sdm.bench.segmentation.ensemble_tables import ensembles_tables, mixtures_tables
from sdm.bench.segmentation.ensembles import (
    ENSEMBLE_S,
    as_ensemble,
    cases_of,
    ensemble,
    ensemble_after,
    ensemble_jobs,
    kept_file,
    kept_trainings,
    not_done,
    refuse_other_networks,
    shapes_for,
    too_few,
)
from sdm.bench.segmentation.gpu_jobs import devices, run_jobs
from sdm.bench.segmentation.log_file import Job, LogFile, groups_of, log_file, short
from sdm.bench.segmentation.mixtures import mixtures, refuse_folders
from sdm.bench.segmentation.time_budget import fitted_steps, known_steps, shared
from sdm.bench.segmentation.trials import settings_of
from sdm.core.mesh import TriangleMesh
from sdm.engine.api import signed_distance_map
from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.segmentation import (
    MA_ROWS,
    METHODS,
    Case,
    Patches,
    Settings,
    SyntheticPatches,
    TrainedModel,
    Training,
    cell,
    read_cases,
    save_model,
    table,
    train,
    validate,
)

LOGS = LogFile(results_folder() / "segmentation_ma.jsonl")
COLUMNS = ("dice", "jaccard", "hausdorff95_mm", "average_surface_distance_mm", "contour_dice")
# Seconds until the processes train, and of a job beside its steps: preparing the cases, and prediction.
STARTING_S = 25.0
OVERHEAD_S = 8.0
SEEDS = (0, 1, 2)
TETRAHEDRON = ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))
ROWS = (*MA_ROWS, "pwr", "hausdorff-foreground")


def main() -> None:
    options = parser().parse_args()
    if options.what == "table":
        print(tables(options))
        return
    if not options.keep and (options.ensemble or options.what == "ensemble"):
        raise SystemExit("ensembles are made of networks that were kept: give a folder with --keep")
    if options.beside and options.what != "ensemble":
        raise SystemExit(f"--beside is for networks that were kept: say ensemble in place of {options.what}")
    on = devices(options.gpus) * options.per_gpu
    end = time.monotonic() + options.budget_s
    # Once, before several processes want it at the same time.
    for device in on[:1]:
        euclidean_distance_transform(torch.ones(4, 4, 4, dtype=torch.bool, device=device), signed=True)
        if options.synthetic:
            signed_distance_map(TriangleMesh(torch.eye(4)[:, :3], torch.tensor(TETRAHEDRON)), 16, device=device)
    if options.beside:
        make_mixtures(options, end, on)
    elif options.what == "ensemble":
        make_ensembles(kept_trainings(options.keep, job_of(options), options.methods, options.seeds), options, end, on)
    else:
        make_trainings(options, end, on)
    print(tables(options))


def make_trainings(options: argparse.Namespace, end: float, on: list[str]) -> None:
    """All rows and seeds; with --ensemble the mean over a row's seeds as soon as the last of them is trained."""
    if options.ensemble:
        options.budget_s -= STARTING_S + ENSEMBLE_S * -(-len(options.methods) // len(on))
    if options.fit:
        options.steps = known_steps(options.logs) or fit(options, on)
    listed = jobs(options)
    refuse_others(listed, options.logs)
    if options.keep:
        refuse_other_networks(listed, options.keep)
        options.keep.mkdir(parents=True, exist_ok=True)
    follow = None
    if options.ensemble:
        refuse_others([as_ensemble([job], options.keep) for job in listed], options.logs)
        follow = partial(ensemble_after, listed=listed, keep=options.keep, logs=options.logs)
    task = partial(work, keep=options.keep)
    run_jobs(listed, task, options.logs, options.work, budget_s=options.budget_s, on=on, follow=follow)
    if options.ensemble:
        make_ensembles(listed, options, end, on)


def make_ensembles(listed: list[Job], options: argparse.Namespace, end: float, on: list[str]) -> None:
    """Those of the trainings' networks that are kept and not done yet."""
    refuse_others(listed, options.logs)
    todo = ensemble_jobs(listed, options.keep, options.logs)
    refuse_others([as_ensemble([job], options.keep) for job in listed], options.logs)
    if few := too_few(listed, options.keep):
        print(f"fewer than two networks are kept of {', '.join(few)}: no ensemble", flush=True)
    average(todo, options, end, on)


def make_mixtures(options: argparse.Namespace, end: float, on: list[str]) -> None:
    """The ensembles over networks of several folders that are not done yet."""
    refuse_folders(options.keep, options.beside, options.logs, LOGS)
    listed = mixtures(job_of(options), options.keep, options.beside, options.methods, options.seeds)
    refuse_others(listed, options.logs)
    average(not_done(listed, options.logs), options, end, on)


def average(todo: list[Job], options: argparse.Namespace, end: float, on: list[str]) -> None:
    """Do ensembles, in the time that is left."""
    if todo and time.monotonic() >= end:
        print(f"no time is left for {', '.join(job['name'] for job in todo)}", flush=True)
        return
    for job in todo:
        # It may be there, of fewer seeds.
        options.logs.remove(job["name"])
    run_jobs(todo, work, options.logs, options.work, budget_s=end - time.monotonic(), on=on[: max(1, len(todo))])


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "ensemble", "table"))
    parser.add_argument("--data", type=Path, default=data_folder() / "la")
    parser.add_argument("--logs", type=log_file, default=LOGS)
    parser.add_argument("--work", type=Path, default=Path("/tmp/sdm-segmentation-ma"), help="unfinished trainings")
    parser.add_argument("--keep", type=Path, default=None, help="folder for the networks, METHOD-SEED.pt")
    parser.add_argument(
        "--beside", type=Path, nargs="+", default=[], help="ensemble: folders of networks to average with those too"
    )
    parser.add_argument(
        "--ensemble", action="store_true", help="run: the mean over seeds too; some of the budget is left for it"
    )
    parser.add_argument("--budget-s", type=float, default=3600.0)
    parser.add_argument("--gpus", type=int, default=None, help="default: all")
    parser.add_argument("--per-gpu", type=int, default=1, help="processes on each: 2 fill the gaps of small networks")
    parser.add_argument("--methods", nargs="+", default=list(ROWS), choices=list(METHODS))
    parser.add_argument("--seeds", type=int, nargs="+", default=None, help="default 0 1 2; of an ensemble all kept")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--fit", action="store_true", help="as many steps as fit into the budget, in place of --steps")
    parser.add_argument("--patch", type=int, nargs=3, default=[112, 112, 80])
    parser.add_argument("--coarsen", type=int, default=1, help="voxels so many times as large; a patch counts those")
    parser.add_argument("--batch-size", dest="batch", type=int, default=2)
    parser.add_argument("--optimizer", choices=("adam", "sgd"), default="sgd")
    parser.add_argument("--learning-rate", type=float, default=0.05)
    parser.add_argument("--schedule", choices=("cosine", "constant"), default="cosine")
    parser.add_argument("--average", type=float, default=0.0, help="of the weights, over this share of the training")
    parser.add_argument("--augment", choices=("none", "published", "affine", "strong", "scanner"), default="affine")
    parser.add_argument("--targets", choices=("case", "patch"), default="case")
    parser.add_argument("--filters", type=int, default=None)
    parser.add_argument("--dropout", type=float, default=None)
    parser.add_argument("--last-dropout", type=float, default=0.0)
    parser.add_argument("--window", type=int, nargs=3, default=None, help="of the prediction; default a patch")
    parser.add_argument("--stride", type=int, nargs=3, default=None, help="default half a window; published 18 18 4")
    parser.add_argument("--mirrors", default="", help="axes, xyz: mirror images to train on and to average over")
    parser.add_argument("--position", action="store_true", help="tell the network where voxels are in their volume")
    told = "share of the patches that are of synthetic cases: images of DIR, warped to the labels in DIR/labels"
    parser.add_argument("--synthetic", type=float, default=0.0, help=told)
    parser.add_argument("--cases", type=int, default=None, help="only so many of each part, to see that it works")
    told = "near twins of validation cases among those to train on: left out, or kept as in the recorded tables"
    parser.add_argument("--twins", choices=("apart", "kept"), default="apart", help=told)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--bfloat16", action="store_true", help="on a CPU too, where it has it")
    parser.add_argument("--parts", choices=("plain", "largest"), default="largest", help="which scores to print")
    return parser


def jobs(options: argparse.Namespace) -> list[Job]:
    """All methods with the first seed, then all with the next."""
    found = []
    for seed in options.seeds or SEEDS:
        for method in options.methods:
            settings = Settings(
                method=method,
                patch=tuple(options.patch),
                coarsen=options.coarsen,
                batch=options.batch,
                steps=options.steps,
                optimizer=options.optimizer,
                learning_rate=options.learning_rate,
                schedule=options.schedule,
                average=options.average,
                augment=options.augment,
                mirrors=options.mirrors,
                targets=options.targets,
                filters=options.filters,
                dropout=options.dropout,
                last_dropout=options.last_dropout,
                position=options.position,
                synthetic=options.synthetic,
                seed=seed,
            )
            found.append({"name": f"{method}-{seed}", "settings": settings.record(), **job_of(options)})
    return found


def job_of(options: argparse.Namespace) -> Job:
    """Fields that all jobs have in common beside their settings."""
    return {
        "data": str(options.data),
        "cases": options.cases,
        "twins": options.twins,
        "window": options.window,
        "stride": options.stride,
        "mirrors": options.mirrors,
        "compile": options.compile,
        "bfloat16": options.bfloat16,
    }


def refuse_others(listed: list[Job], logs: LogFile) -> None:
    """A log of another protocol must not pass for a training, or an ensemble, of this one."""
    found = [*logs.trainings(), *logs.ensembles()]
    known = {log["job"]["name"]: protocols(log["job"]) for log in found}
    for job in listed:
        own = short(protocols(job))
        if known.get(job["name"], own) != own:
            raise SystemExit(
                f"{job['name']} in {logs} is of a training with other settings: choose another file with --logs"
            )


def protocols(job: Job) -> list[dict[str, Any]]:
    """The settings of a training, or of all networks of an ensemble."""
    # Logs of before there was a choice have the twins among the training cases.
    return [settings_of({"job": group}) | {"twins": group.get("twins", "kept")} for group in groups_of(job)]


def fit(options: argparse.Namespace, on: list[str]) -> int:
    """Steps that let all jobs end within the budget, from a measurement on the first device."""
    cases = read_cases(options.data, "train")[:4]
    begin = time.monotonic()
    settings = Settings.of_record(jobs(options)[0]["settings"])
    patches = Patches.of_settings(cases, replace(settings, method="head-sdf-l1"), on[0])
    torch.backends.cudnn.benchmark = True

    def measure(steps: int) -> float:
        short = replace(settings, method="head-sdf-l1", steps=steps)
        return train(patches, short, compiled=options.compile, bfloat16=options.bfloat16 or None).seconds

    measure(2)
    left = options.budget_s - (time.monotonic() - begin) - STARTING_S
    count = len(options.methods) * len(options.seeds or SEEDS)
    steps = fitted_steps(measure, count, len(on), left, weight=1.2 * shared(options.per_gpu), overhead_s=OVERHEAD_S)
    options.budget_s -= time.monotonic() - begin
    torch.cuda.empty_cache()
    return steps


def work(
    job: Job, device: str, unfinished: Path, kept: dict[str, Any], deadline: float, *, keep: Path | None = None
) -> dict[str, Any] | None:
    """One training and its scores, or an ensemble's."""
    if "seeds" in job:
        return ensemble(job, device, kept)
    settings = Settings.of_record(job["settings"])
    cases, others = cases_of(job, "train", kept), cases_of(job, "val", kept)
    if device.startswith("cuda"):
        torch.cuda.reset_peak_memory_stats(device)
    checkpoint = unfinished / f"{job['name']}.pt"
    patches = patches_for(job, settings, cases, device, kept)
    training: Training = train(
        patches,
        settings,
        checkpoint=checkpoint,
        deadline=deadline,
        compiled=job["compile"],
        bfloat16=job["bfloat16"] or None,
    )
    if training.step < settings.steps:
        return None
    if keep is not None:
        save_model(TrainedModel(training.model, settings, cases[0].spacing), kept_file(keep, job))
    begin = time.monotonic()
    with torch.no_grad():
        scores = list(
            validate(
                training.model,
                others,
                job["window"] or settings.patch,
                stride=job["stride"],
                mirrors=job["mirrors"],
            )
        )
    log = {
        "training_s": training.seconds,
        "prediction_s": time.monotonic() - begin,
        "parameters": sum(p.numel() for p in training.model.parameters()),
        "memory_gib": torch.cuda.max_memory_allocated(device) / 2**30 if device.startswith("cuda") else None,
        "machine": describe(device, ("torch",)),
        "losses": training.losses,
        "plain": {name: plain for name, plain, _ in scores},
        "largest": {name: largest for name, _, largest in scores},
    }
    checkpoint.unlink(missing_ok=True)
    return {"summary": _summary(list(log["largest"].values()), training), **log}


def patches_for(
    job: Job, settings: Settings, cases: list[Case], device: str, kept: dict[str, Any]
) -> Patches | SyntheticPatches:
    """Patches of real cases, or with synthetic ones beside them, whose warps are found once in a process."""
    if not settings.synthetic:
        return Patches.of_settings(cases, settings, device)
    shapes = shapes_for(job, kept)
    patches = SyntheticPatches.of_settings_and_shapes(cases, settings, device, shapes)
    patches.warps = kept.setdefault("warps", patches.warps)
    return patches


def _summary(cases: list[dict[str, Any]], training: Training) -> str:
    rate = training.step / max(training.seconds, 1e-9)
    return f"Dice {cell(cases, 'dice')}, 95HD {cell(cases, 'hausdorff95_mm')}, {rate:.1f} steps/s"


def tables(options: argparse.Namespace) -> str:
    """Of the trainings and, if there are any, of the ensembles."""
    files = {options.logs.name: options.logs}
    found = [text for text in (ensembles_tables(files), mixtures_tables(files, LOGS.trainings())) if text]
    if not found or options.logs.trainings():
        found.insert(0, table_of(options.logs, options.parts))
    return "\n\n".join(found)


def table_of(logs: LogFile, parts: str) -> str:
    """A row for each method; its cases are those of all seeds."""
    rows: dict[str, list[dict[str, Any]]] = {}
    seeds: dict[str, int] = {}
    for log in logs.trainings():
        name = log["job"]["settings"]["method"]
        rows.setdefault(name, []).extend(log[parts].values())
        seeds[name] = seeds.get(name, 0) + 1
    ordered = {f"{name} ({seeds[name]})": rows[name] for name in METHODS if name in rows}
    return table(ordered, COLUMNS, unit="voxels") if ordered else f"no logs in {logs}"


if __name__ == "__main__":
    main()
