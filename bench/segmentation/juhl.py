"""Juhl's study of simple shapes: voxel-wise classification (PWC) against regression of a signed distance (PWR).

    python -m sdm.bench.segmentation.juhl run --budget-s 200     # goes on where it was; all GPUs
    python -m sdm.bench.segmentation.juhl table                  # the table from the logs

K. Juhl et al., "Guiding 3D U-nets with signed distance fields for creating 3D models from images", MIDL 2019: cuboids,
rhomboids, ellipsoids and cylinders in 512^3 voxels, 19 of each to train on and 6 to test on; networks of 64^3. Labels
of PWC are enlarged by the nearest voxel, PWR's distances linearly and then cut at zero. Controls: PWC with linearly
enlarged probabilities, so that both are enlarged alike; and PWR on the exact map of the mesh and on the transform of
the coarse label, beside that of the fine label.

How the paper's images were made is not known here: an image's voxel is the share of it that is inside, with Gaussian
noise of 0.1. The paper trains PWC with a cross-entropy loss; so does `pwc-ce`, and `pwc` minimises
(cross-entropy + Dice) / 2. Each network is trained at each of the same rates by the first seed; the rate with the
highest Dice (linearly enlarged) of shapes that are neither to train on nor to test on is that of all its seeds.
Distances are in voxels of 512^3. Overlap near the contour: 5^3 band.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.machine import describe
from sdm.bench.segmentation.gpu_jobs import PATHS, devices, run_jobs
from sdm.bench.segmentation.juhl_shapes import TARGETS, Shape, ShapeBatches, shapes
from sdm.bench.segmentation.log_file import Job, Log, LogFile, log_file
from sdm.bench.segmentation.time_budget import fitted_steps, known_steps, shared
from sdm.bench.studies.rate_search import best_rate
from sdm.segmentation import Settings, TrainedModel, Training, cell, load_model, save_model, scores_of, table, train

LOGS = LogFile(results_folder() / "segmentation_juhl_rates.jsonl")
# Five seeds at one rate, longer trainings of larger networks, made before the families' shapes were independent.
ONE_RATE = LogFile(results_folder() / "segmentation_juhl.jsonl")
COLUMNS = ("dice", "contour_dice", "average_surface_distance_mm", "rms_surface_distance_mm")
# Network -> its target; None: the label.
NETWORKS: dict[str, str | None] = {"pwc-ce": None, "pwc": None, **{f"pwr-{target}": target for target in TARGETS}}
METHODS = {name: "pwr" if target else {"pwc-ce": "pwc"}.get(name, "baseline") for name, target in NETWORKS.items()}
RATES = (3e-4, 1e-3, 3e-3)
ROWS = {
    "pwc-ce nearest": "PWC (CE), nearest (as published)",
    "pwc-ce linear": "PWC (CE), linear probabilities",
    "pwc nearest": "PWC (CE + Dice; published: CE), nearest",
    "pwc linear": "PWC, linear probabilities",
    "pwr-voxels nearest": "PWR on the labels' transform, nearest",
    "pwr-voxels linear": "PWR on the labels' transform, linear (as published)",
    "pwr-mesh linear": "PWR on the mesh's exact map, linear",
    "pwr-coarse linear": "PWR on the coarse labels' transform, linear",
}
# Voxels beyond the foreground that no score looks further than.
ROOM = 8
# Seconds until the processes train: shapes are made. Seconds of a job beside its steps: scores.
STARTING_S = 40.0
OVERHEAD_S = 8.0


def main() -> None:
    options = parser().parse_args()
    if options.what == "run":
        on = devices(options.gpus) * options.per_gpu
        # Compiled once, before several processes want it at the same time.
        few = list(_few(options, on[0]))
        if options.fit:
            options.steps = known_steps(options.logs) or fit(options, few, on)
        task = partial(work, logs=options.logs)
        run_jobs(jobs(options), task, options.logs, options.work, budget_s=options.budget_s, on=on)
    print(tables_of(options.logs))


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("--logs", type=log_file, default=LOGS)
    parser.add_argument("--work", type=Path, default=Path("/tmp/sdm-segmentation-juhl"), help="unfinished trainings")
    parser.add_argument("--budget-s", type=float, default=3600.0)
    parser.add_argument("--gpus", type=int, default=None, help="default: all")
    parser.add_argument("--per-gpu", type=int, default=1, help="processes on each: 2 fill the gaps of small networks")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--networks", nargs="+", default=list(NETWORKS), choices=list(NETWORKS))
    parser.add_argument("--steps", type=int, default=1350, help="default: those of the table that is kept")
    parser.add_argument("--fit", action="store_true", help="as many steps as fit into the budget, in place of --steps")
    parser.add_argument("--batch-size", dest="batch", type=int, default=4)
    parser.add_argument("--rates", type=float, nargs="+", default=list(RATES), help="to choose from, for each network")
    parser.add_argument("--filters", type=int, default=32)
    parser.add_argument("--fine", type=int, default=512)
    parser.add_argument("--coarse", type=int, default=64)
    parser.add_argument("--compile", action="store_true")
    return parser


def jobs(options: argparse.Namespace) -> list[Job]:
    """The search for the rates, then all networks with the first seed, all with the next."""

    def job(network: str, seed: int, rate: float) -> Job:
        settings = Settings(
            method=METHODS[network],
            architecture="unet",
            patch=(options.coarse,) * 3,
            batch=options.batch,
            steps=options.steps,
            learning_rate=rate,
            filters=options.filters,
            seed=seed,
        )
        return {"network": network, "settings": settings.record(), "fine": options.fine, "compile": options.compile}

    first = options.seeds[0]
    found = [
        {"name": f"{network}-rate-{rate:g}", "kind": "rate", **job(network, first, rate)}
        for network in options.networks
        for rate in options.rates
    ]
    # Their rate is chosen when they begin.
    return found + [
        {"name": f"{network}-{seed}", "kind": "test", "rates": options.rates, **job(network, seed, options.rates[0])}
        for seed in options.seeds
        for network in options.networks
    ]


def _few(options: argparse.Namespace, device: str) -> list[Shape]:
    source = shapes("train", options.fine, options.coarse, device)
    return [next(source) for _ in range(2)]


def fit(options: argparse.Namespace, few: list[Shape], on: list[str]) -> int:
    """Steps that let all jobs end within the budget, from a measurement on the first device."""
    begin = time.monotonic()
    torch.backends.cudnn.benchmark = True
    batches = ShapeBatches(few, "mesh")

    def measure(steps: int) -> float:
        settings = Settings(
            method="pwr",
            architecture="unet",
            patch=(options.coarse,) * 3,
            batch=options.batch,
            steps=steps,
            filters=options.filters,
        )
        return train(batches, settings, compiled=options.compile).seconds

    count = len(options.networks) * (len(options.rates) + len(options.seeds) - 1)
    left = options.budget_s - STARTING_S
    steps = fitted_steps(measure, count, len(on), left, weight=shared(options.per_gpu), overhead_s=OVERHEAD_S)
    options.budget_s -= time.monotonic() - begin
    return steps


def work(
    job: Job, device: str, unfinished: Path, kept: dict[str, Any], deadline: float, *, logs: LogFile
) -> Log | None:
    """One training and the scores of its validation shapes, or, at the rate they chose, of its test shapes."""
    if job["kind"] == "test":
        rate = best_rate(partial(rates_of, logs, job["network"]), job["rates"], deadline)
        if rate is None:
            return None
        job = {**job, "settings": {**job["settings"], "learning_rate": rate}}
    settings = Settings.of_record(job["settings"])
    part = "test" if job["kind"] == "test" else "validation"
    for name in ("train", part):
        if name not in kept:
            kept[name] = list(shapes(name, job["fine"], settings.patch[0], device))
    training = trained(job, settings, kept["train"], unfinished, deadline, logs)
    if training is None:
        return None
    begin = time.monotonic()
    scores: dict[str, list[dict[str, Any]]] = {"nearest": [], "linear": []}
    for shape in kept[part]:
        with torch.inference_mode():
            values = training.model.field(shape.image[None, None])
        truth = shape.truth
        if truth is None:
            raise ValueError("a shape to score has no truth")
        for way, found in scores.items():
            found.append(score(enlarged(values, job["fine"], way), truth))
    told = f"Dice linear {cell(scores['linear'], 'dice')}, {training.step / max(training.seconds, 1e-9):.1f} steps/s"
    return {
        "summary": told,
        "job": {key: value for key, value in job.items() if key not in PATHS},
        "training_s": training.seconds,
        "scores_s": time.monotonic() - begin,
        "parameters": sum(p.numel() for p in training.model.parameters()),
        "machine": describe(device, ("torch", "warp-lang")),
        "losses": training.losses,
        **(scores if part == "test" else {"validation": scores}),
    }


def rates_of(logs: LogFile, network: str) -> dict[float, float]:
    """Rate -> 1 less the mean Dice of the validation shapes, linearly enlarged, of those tried."""
    own = [log for log in logs.trainings() if "validation" in log and log["job"]["network"] == network]
    return {
        log["job"]["settings"]["learning_rate"]: 1
        - statistics.fmean(row["dice"] for row in log["validation"]["linear"])
        for log in own
    }


def trained(
    job: Job, settings: Settings, source: list[Shape], unfinished: Path, deadline: float, logs: LogFile
) -> Training | None:
    """The network of a job, trained now, or when its rate was tried; None where the deadline came first."""
    rate = f"{job['network']}-rate-{settings.learning_rate:g}"
    kept = unfinished / f"{rate}-{settings.seed}.network.pt"
    if kept.is_file():
        found = load_model(kept, source[0].image.device)
        before = next(
            (log for log in logs.trainings() if log["job"]["name"] == rate), {"training_s": 0.0, "losses": []}
        )
        if found.settings == settings:
            return Training(found.model.eval(), settings.steps, before["training_s"], before["losses"])
    checkpoint = unfinished / f"{job['name']}.pt"
    batches = ShapeBatches(source, NETWORKS[job["network"]])
    training = train(batches, settings, checkpoint=checkpoint, deadline=deadline, compiled=job["compile"])
    if training.step < settings.steps:
        return None
    if job["kind"] == "rate":
        save_model(TrainedModel(training.model, settings, batches.spacing), kept)
    checkpoint.unlink(missing_ok=True)
    return training


def enlarged(values: Tensor, fine: int, way: str) -> Tensor:
    """Mask of (1,1,n,n,n) values that are negative once they are enlarged: (fine,fine,fine) bool."""
    if way == "linear":
        return functional.interpolate(values, size=(fine,) * 3, mode="trilinear", align_corners=False)[0, 0] < 0
    label = (values[0, 0] < 0).to(torch.uint8)
    return functional.interpolate(label[None, None].float(), size=(fine,) * 3, mode="nearest")[0, 0] > 0.5


def score(prediction: Tensor, truth: Tensor) -> dict[str, float | bool]:
    """Scores in the box of both masks and some room, which are those of the whole volume, in less time."""
    box = []
    both = prediction | truth
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        index = torch.nonzero(both.any(others[1]).any(others[0]))
        box.append(slice(max(0, int(index.min()) - ROOM), int(index.max()) + ROOM + 1))
    inner = (box[0], box[1], box[2])
    return scores_of(prediction[inner], truth[inner], (1.0, 1.0, 1.0))


def tables_of(logs: LogFile) -> str:
    """The search for the rates, if there was one, and the table."""
    found = rates_table(logs)
    return f"{found}\n\n{table_of(logs)}" if found else table_of(logs)


def rates_table(logs: LogFile, of: str = "validation shapes") -> str:
    """Dice of what chooses rates, linearly enlarged, for each network and rate; the highest in bold."""
    own = {name: {r: f"{100 * (1 - e):.2f}" for r, e in rates_of(logs, name).items()} for name in NETWORKS}
    rates = sorted({rate for row in own.values() for rate in row})
    lines = [f"| Dice of {of} [%] |" + "".join(f" rate {rate:g} |" for rate in rates)]
    lines.append("|---|" + "---|" * len(rates))
    for name, row in own.items():
        best = max(row.values(), key=float, default="")
        cells = [f"**{row[r]}**" if row.get(r) == best else row.get(r, "-") for r in rates]
        lines += [f"| `{name}` | {' | '.join(cells)} |"] if row else []
    return "\n".join(lines) if rates else ""


def table_of(logs: LogFile, texts: Mapping[str, str] = ROWS) -> str:
    """A row for each network and way to enlarge; its cases are those of all seeds."""
    rows: dict[str, list[dict[str, Any]]] = {}
    seeds: dict[str, int] = {}
    for log in logs.trainings():
        for way in ("nearest", "linear") if "linear" in log else ():
            name = f"{log['job']['network']} {way}"
            rows.setdefault(name, []).extend(log[way])
            seeds[name] = seeds.get(name, 0) + 1
    ordered = {f"{text} ({seeds[name]})": rows[name] for name, text in texts.items() if name in rows}
    return table(ordered, COLUMNS, unit="voxels") if ordered else "There are no scores of test shapes yet."


if __name__ == "__main__":
    main()
