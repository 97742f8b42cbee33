"""Juhl's comparison on left atria: voxel-wise classification (PWC) against regression of a signed distance (PWR).

    python -m sdm.bench.segmentation.juhl_atria run --data DIR/la --compile --per-gpu 4 --budget-s 400   # goes on
    python -m sdm.bench.segmentation.juhl_atria table

K. Juhl et al., MIDL 2019, have a table of left atrial appendages in CT, which are not public. This is the same question
on the left atria in MRI that the study of Ma's rows has: 3D U-Nets see images of voxels three times as large, a whole
volume at once (80 x 56 x 32, where the paper has 64^3), and are scored on the images' own voxels. Labels of PWC are
enlarged by the nearest voxel, PWR's distances linearly and then cut at zero; the controls are those of
`sdm.bench.segmentation.juhl`: PWC by cross-entropy + Dice, both ways to enlarge for each network, and PWR on the
transform of the coarse label and on the exact map of the label's smooth surface (`label_surface`).

Rates: each network is trained at each of the same rates, without every fourth of the training cases and their near
twins; the rate with the highest Dice of these (linearly enlarged) is that of all its seeds, which train on all cases.
So the validation cases, by which the tables are, choose nothing. Near twins of theirs are not trained on. A wider grid
goes on with the rates that were tried; run it again to train those anew whose rate is another since. With one rate
there is no search: `--logs FILE.jsonl/NAME --rates 1e-4 --networks pwr-voxels --steps 2000` is a trial of its own.
Largest connected component; distances in the images' voxels.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from sdm.bench.common.checkout import data_folder, results_folder
from sdm.bench.common.machine import describe
from sdm.bench.deepsdf.study.atria_split import read_record, twins_of
from sdm.bench.segmentation.ensembles import cases_of
from sdm.bench.segmentation.gpu_jobs import PATHS, devices, run_jobs
from sdm.bench.segmentation.juhl import COLUMNS, METHODS, NETWORKS, rates_of, rates_table, table_of
from sdm.bench.segmentation.log_file import Job, Log, LogFile, log_file
from sdm.bench.studies.intervals import difference
from sdm.bench.studies.rate_search import best_rate
from sdm.core.grid import Grid
from sdm.deepsdf.samples.label_surface import label_surface
from sdm.engine.api import signed_distance_map
from sdm.segmentation import Case, Patches, Settings, cell, scores_of, train
from sdm.segmentation.data.downsample import coarse_image, fine_field
from sdm.segmentation.data.method_target import distance_map
from sdm.segmentation.infer.predict import coarse_field, largest_component
from sdm.segmentation.infer.scores import COLUMNS as UNITS
from sdm.segmentation.train.methods import Map

LOGS = LogFile(results_folder() / "segmentation_juhl_atria.jsonl")
RATES = (3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
SEEDS = (0, 1, 2)
# Every so many-th of the training cases chooses rates.
CHOOSING = 4
ROWS = {
    "pwc-ce nearest": "PWC (CE), nearest (as published)",
    "pwc-ce linear": "PWC (CE), linear probabilities",
    "pwc nearest": "PWC (CE + Dice), nearest",
    "pwc linear": "PWC (CE + Dice), linear probabilities",
    "pwr-voxels nearest": "PWR on the labels' transform, nearest",
    "pwr-voxels linear": "PWR on the labels' transform, linear (as published)",
    "pwr-mesh linear": "PWR on the exact map of the labels' smooth surface, linear",
    "pwr-coarse linear": "PWR on the coarse labels' transform, linear",
}
# What is said to gain, over what.
GAINS = {
    "PWR over PWC (CE), as published": ("pwr-voxels linear", "pwc-ce nearest"),
    "PWR over PWC (CE), both linear": ("pwr-voxels linear", "pwc-ce linear"),
    "PWR over PWC (CE + Dice), both linear": ("pwr-voxels linear", "pwc linear"),
    "linear over nearest, PWC (CE)": ("pwc-ce linear", "pwc-ce nearest"),
    "linear over nearest, PWR": ("pwr-voxels linear", "pwr-voxels nearest"),
    "PWR's fine over coarse labels' transform": ("pwr-voxels linear", "pwr-coarse linear"),
    "PWR's exact surface over labels' transform": ("pwr-mesh linear", "pwr-voxels linear"),
}


class AtriumPatches(Patches):
    """Patches whose clipped signed distance is of one of `juhl_shapes.TARGETS`; None: labels alone."""

    def __init__(self, cases: Sequence[Case], target: str | None, settings: Settings, device: str) -> None:
        self._target = target
        kind: Map | None = None if target is None else "clipped"
        super().__init__(cases, kind, settings.patch, device, mirrors=settings.mirrors, coarsen=settings.coarsen)

    def _case_map(self, case: Case, label: Tensor, kind: Map) -> Tensor:
        if self._target == "coarse":
            coarse = (coarse_image(label, self.coarsen) > 0.5).float()
            return distance_map(coarse[None, None], kind, self.spacing)[0, 0]
        if self._target != "mesh" or case.label is None:
            return super()._case_map(case, label, kind)
        mesh = label_surface(case.label, case.spacing, smoothing_mm=1.25 * max(case.spacing))
        shape = [n // self.coarsen for n in label.shape]
        # Voxels of padding before the case, in its own voxels.
        before = [(n + -m // self.coarsen) // 2 * self.coarsen for n, m in zip(shape, case.label.shape, strict=True)]
        origin = [((self.coarsen - 1) / 2 - b) * s for b, s in zip(before, case.spacing, strict=True)]
        grid = Grid((origin[0], origin[1], origin[2]), self.spacing, (shape[0], shape[1], shape[2]))
        return signed_distance_map(mesh.to(self.device), grid, device=self.device).values


def main() -> None:
    options = parser().parse_args()
    if options.what == "run":
        on = devices(options.gpus) * options.per_gpu
        remove_outdated(options)
        listed = jobs(options)
        known = options.logs.names()
        if len(on) > 1 and any(job["name"] not in known for job in listed):
            # Compiled once, before several processes want it at the same time.
            compile_once(listed[0], on[0])
        run_jobs(listed, partial(work, logs=options.logs), options.logs, options.work, budget_s=options.budget_s, on=on)
    print(tables_of(options.logs))


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("--data", type=Path, default=data_folder() / "la")
    parser.add_argument("--logs", type=log_file, default=LOGS)
    parser.add_argument("--work", type=Path, default=Path("/tmp/sdm-segmentation-atria"), help="unfinished trainings")
    parser.add_argument("--budget-s", type=float, default=3600.0)
    parser.add_argument("--gpus", type=int, default=None, help="default: all")
    parser.add_argument("--per-gpu", type=int, default=1, help="processes on each: several fill each other's gaps")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--networks", nargs="+", default=list(NETWORKS), choices=list(NETWORKS))
    parser.add_argument("--rates", type=float, nargs="+", default=list(RATES), help="to choose from, for each network")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--patch", type=int, nargs=3, default=[80, 56, 32])
    parser.add_argument("--coarsen", type=int, default=3)
    parser.add_argument("--batch-size", dest="batch", type=int, default=2)
    parser.add_argument("--filters", type=int, default=32)
    parser.add_argument("--compile", action="store_true")
    return parser


def jobs(options: argparse.Namespace) -> list[Job]:
    """The search for the rates, then all networks with the first seed, all with the next."""

    def job(network: str, seed: int, rate: float) -> Job:
        settings = Settings(
            method=METHODS[network],
            architecture="unet",
            patch=tuple(options.patch),
            coarsen=options.coarsen,
            batch=options.batch,
            steps=options.steps,
            learning_rate=rate,
            augment="strong",
            mirrors="",
            filters=options.filters,
            seed=seed,
        )
        common = {"data": str(options.data), "cases": None, "twins": "apart", "compile": options.compile}
        return {"network": network, "settings": settings.record(), **common}

    found = [
        {"name": f"{network}-rate-{rate:g}", "kind": "rate", **job(network, options.seeds[0], rate)}
        for network in options.networks
        for rate in options.rates
        if len(options.rates) > 1
    ]
    # Their rate is chosen when they begin.
    return found + [
        {"name": f"{network}-{seed}", "kind": "test", "rates": options.rates, **job(network, seed, options.rates[0])}
        for seed in options.seeds
        for network in options.networks
    ]


def remove_outdated(options: argparse.Namespace) -> None:
    """Take out the logs of trainings at a rate that is not the best of the grid any more, once all of it is tried."""
    for network in options.networks:
        tried = rates_of(options.logs, network)
        if not set(options.rates) <= set(tried):
            continue
        best = min(options.rates, key=tried.__getitem__)
        for log in options.logs.trainings():
            job = log["job"]
            if (job["network"], job["kind"]) == (network, "test") and job["settings"]["learning_rate"] != best:
                options.logs.remove(job["name"])


def compile_once(job: Job, device: str) -> None:
    """Two steps on one case with the exact map of its surface, which need all kernels that a training needs."""
    settings = Settings.of_record({**job["settings"], "steps": 2, "method": "pwr"})
    train(AtriumPatches(cases_of(job, "train", {})[:1], "mesh", settings, device), settings, compiled=job["compile"])


def parts_of(cases: Sequence[Case]) -> tuple[list[Case], list[Case]]:
    """Of the training cases those to train on while rates are chosen, and those that choose; no twins in both."""
    choosing = list(cases[1::CHOOSING])
    near = twins_of(read_record(), [case.name for case in choosing])
    chosen = {case.name for case in choosing}
    return [case for case in cases if case.name not in near | chosen], choosing


def work(
    job: Job, device: str, unfinished: Path, kept: dict[str, Any], deadline: float, *, logs: LogFile
) -> Log | None:
    """One training and the scores of the cases that choose, or, at the rate they chose, of the validation cases."""
    rated = job["kind"] == "rate"
    if not rated and len(job["rates"]) > 1:
        rate = best_rate(partial(rates_of, logs, job["network"]), job["rates"], deadline)
        if rate is None:
            return None
        job = {**job, "settings": {**job["settings"], "learning_rate": rate}}
    settings = Settings.of_record(job["settings"])
    cases, others = cases_of(job, "train", kept), cases_of(job, "val", kept)
    if rated:
        cases, others = parts_of(cases)
    target = NETWORKS[job["network"]]
    if (key := f"patches {target} {rated}") not in kept:
        kept[key] = AtriumPatches(cases, target, settings, device)
    checkpoint = unfinished / f"{job['name']}.pt"
    training = train(kept[key], settings, checkpoint=checkpoint, deadline=deadline, compiled=job["compile"])
    if training.step < settings.steps:
        return None
    begin = time.monotonic()
    scored = scores(training.model, others, settings)
    checkpoint.unlink(missing_ok=True)
    told = f"Dice linear {cell(scored['linear'], 'dice')}, {training.step / max(training.seconds, 1e-9):.1f} steps/s"
    return {
        "summary": told,
        "job": {key: value for key, value in job.items() if key not in PATHS},
        "training_s": training.seconds,
        "scores_s": time.monotonic() - begin,
        "parameters": sum(p.numel() for p in training.model.parameters()),
        "machine": describe(device, ("torch", "warp-lang")),
        "losses": training.losses,
        "scored": [case.name for case in others],
        **({"validation": scored} if rated else scored),
    }


def scores(model: Any, cases: Sequence[Case], settings: Settings) -> dict[str, list[dict[str, Any]]]:
    """Of each case's largest component, for both ways to enlarge what the network says."""
    found: dict[str, list[dict[str, Any]]] = {"nearest": [], "linear": []}
    for case in cases:
        values = coarse_field(model, case.image, settings.patch)
        if case.label is None:
            raise ValueError(f"{case.name} has no label")
        truth = case.label.to(values.device)
        for way, own in found.items():
            label = largest_component(enlarged(values, settings.coarsen, truth.shape, way))
            own.append(scores_of(label, truth, case.spacing))
    return found


def enlarged(values: Tensor, factor: int, shape: Sequence[int], way: str) -> Tensor:
    """Mask (x,y,z) of values at larger voxels (x',y',z') that are negative once they are enlarged."""
    if way == "linear":
        return fine_field(values, factor, shape) < 0
    label = values < 0
    for axis, count in enumerate(shape):
        label = label.repeat_interleave(factor, axis).narrow(axis, 0, count)
    return label


def tables_of(logs: LogFile) -> str:
    """The search for the rates, the scores, and what gains over what."""
    parts = [rates_table(logs, of="training cases left out"), table_of(logs, ROWS)]
    if gains := gains_table(logs):
        parts += ["Differences by case, means over the seeds, with 95 % intervals over the cases:", gains]
    return "\n\n".join(part for part in parts if part)


def gains_table(logs: LogFile) -> str:
    """A row for each gain: mean difference over the cases with its 95 % interval; empty without scores."""
    found: dict[str, dict[int, dict[str, dict[str, Any]]]] = {}
    for log in logs.trainings():
        for way in ("nearest", "linear") if "linear" in log else ():
            own = found.setdefault(f"{log['job']['network']} {way}", {})
            own[log["job"]["settings"]["seed"]] = dict(zip(log["scored"], log[way], strict=True))
    heads = [f"{UNITS[c][0]} [{'voxels' if UNITS[c][2] == 'mm' else 'points'}]" for c in COLUMNS]
    lines = [f"| gain | {' | '.join(heads)} |", f"|---|{'---|' * len(heads)}"]
    for name, (first, second) in GAINS.items():
        if first not in found or second not in found:
            continue
        cells = []
        for column in COLUMNS:
            one, other = (
                {s: {c: UNITS[column][1] * float(v[column]) for c, v in cases.items()} for s, cases in found[n].items()}
                for n in (first, second)
            )
            if not all(math.isfinite(v) for side in (one, other) for cases in side.values() for v in cases.values()):
                # An empty prediction has no distance.
                cells.append("-")
                continue
            apart = difference(one, other)
            cells.append(f"{apart.mean:+.2f} ± {apart.half_width:.2f}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) if len(lines) > 2 else ""


if __name__ == "__main__":
    main()
