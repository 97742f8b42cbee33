"""Rate of DeepSDF's exact samples, and their cost in a training step.

    python -m sdm.bench.deepsdf.sampling [--device cuda] [--budget-s 60] [--out bench/results/sampling.json]

- `samples`: exact signed distances of fresh samples a second, for batches of 64 shapes with 16,384 points each.
- `share`: how much of a step of the published network (bf16 on a GPU) and of the local one is spent on its samples:
  the time of a step with fresh samples, drawn beside the step before as in training, and with one batch that stays.

Values are checked against every triangle in float64 before they are timed. On a CPU the networks' batches are small:
their share only shows that the program runs; the rate of samples is that of the full batch.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import median, once
from sdm.bench.deepsdf.shapes import cochleas
from sdm.deepsdf.samples import ShapeSet
from sdm.deepsdf.train.settings import VARIANTS, Settings
from sdm.deepsdf.train.training import Trainer, training_state

BATCH, POINTS = 64, 16_384
CHECKED = 500
# Room for the two values' roundings to float32.
TOLERANCE = 4 * 2.0**-24
RUNS = 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--shapes", type=int, default=500)
    parser.add_argument("--triangles", type=int, default=6_000)
    parser.add_argument("--budget-s", type=float, default=60.0, help="of each timing, about")
    parser.add_argument("--no-compile", action="store_true")
    parser.add_argument("--out", type=Path, default=results_folder() / "sampling.json")
    options = parser.parse_args()
    device, gpu = options.device, options.device.startswith("cuda")
    start = time.perf_counter()
    shapes = ShapeSet(cochleas(options.shapes, 1, triangles=options.triangles).training, device)
    built = time.perf_counter() - start
    check(shapes)
    budget_ms = 1e3 * options.budget_s / 4
    result: dict[str, Any] = {
        "machine": describe(device),
        "shapes": len(shapes),
        "triangles_of_a_shape": len(shapes.mesh(0)),
        "seconds_to_build": built,
        "samples": samples(shapes, device, budget_ms),
        "share": {},
    }
    print(json.dumps(result, indent=1), flush=True)
    write(options.out, result)
    for variant in VARIANTS:
        changes = {} if gpu else {"shapes": 4, "points": 512}
        settings = VARIANTS[variant](**changes)
        result["share"][variant] = share(shapes, settings, device, gpu and not options.no_compile, budget_ms)
        print(json.dumps({variant: result["share"][variant]}, indent=1), flush=True)
        # Each part as soon as it is there: networks take a minute to compile.
        write(options.out, result)


def check(shapes: ShapeSet) -> None:
    """Samples of two shapes against every triangle in float64."""
    chosen = torch.tensor([0, len(shapes) - 1], device=shapes.device)
    points, values = shapes.sample(chosen, CHECKED)
    for row, shape in enumerate(chosen.tolist()):
        vertices, faces = shapes.mesh(shape).numpy()
        brute = Brute(vertices, faces, str(shapes.device))
        at = points[row].cpu().numpy()
        distance, inside = brute.distance(at)[0], brute.winding_number(at) > 0.5
        right = torch.from_numpy(distance).double() * (1 - 2 * torch.from_numpy(inside).double())
        worst = float((values[row].cpu().double() - right).abs().max())
        if worst > TOLERANCE:
            raise SystemExit(f"samples of shape {shape} are wrong by {worst:.3g}, so nothing was timed")


def samples(shapes: ShapeSet, device: str, budget_ms: float) -> dict[str, Any]:
    """Rate of whole batches, and of their parts."""
    order = torch.randperm(len(shapes), generator=torch.Generator().manual_seed(0))
    chosen = order[:BATCH].to(shapes.device)
    points = shapes.sample(chosen, POINTS)[0]
    whole = median(lambda: shapes.sample(chosen, POINTS, step=1), device, RUNS, budget_ms)
    distances = median(lambda: shapes.signed_distance(chosen, points), device, RUNS, budget_ms)
    count = len(chosen) * POINTS
    return {
        "batch": [len(chosen), POINTS],
        "ms": whole.ms,
        "ms_of_distances": distances.ms,
        "runs": whole.runs,
        "spread_percent": whole.spread,
        "per_second": 1e3 * count / whole.ms,
    }


def share(shapes: ShapeSet, settings: Settings, device: str, compiled: bool, budget_ms: float) -> dict[str, Any]:
    """A training step with fresh samples, and with samples that stay."""
    trainer = Trainer(shapes, settings, Path(), names=shapes.names, spheres=shapes.spheres, device=device)
    trainer.prepare(compiled)
    kept = trainer.draw(0)
    batches = trainer.batches_ahead()

    def fresh() -> Any:
        return trainer.update(*next(batches))

    def stale() -> Any:
        return trainer.update(*kept)

    with training_state(settings, trainer.device):
        for call in (fresh, stale) * 3:
            once(call, device)
        with_samples = median(fresh, device, RUNS, budget_ms / 2)
        without = median(stale, device, RUNS, budget_ms / 2)
        making = median(lambda: trainer.draw(0), device, RUNS, budget_ms / 2)
    return {
        "compiled": compiled,
        "batch": list(kept[1].shape[:2]),
        "ms": with_samples.ms,
        "ms_without_samples": without.ms,
        "ms_of_samples_alone": making.ms,
        "share": 1 - without.ms / with_samples.ms,
    }


if __name__ == "__main__":
    main()
