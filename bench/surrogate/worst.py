"""The worst case of a surrogate of the cochlea, found by a search over the box of parameters.

    python -m sdm.bench.surrogate.worst [--weights RUN/sdmnn-plus.safetensors] [--budget-s 60] [--out FILE.json]

Every shape's Dice coefficient is that of the voxels inside by the network and by the exact engine. The search begins at
the corners of the box, a grid of three points for each parameter, and points of a Sobol sequence; goes on around the
worst of these by random steps that shrink, some along one parameter alone; and ends at its time. What it finds are
places where the network is bad, not a proof that it is nowhere worse. The record has the worst places, apart from each
other, and says which of the corners is worst. Without --out it is bench/results/surrogate-worst.json.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.core.random import generator
from sdm.shapes import Cochlea, Family
from sdm.stream import TensorGrid
from sdm.surrogate import load_weights, shipped_weights
from sdm.surrogate.train.validation import validation_batches

# Places that are searched around, tries of each in a turn, and the steps' length, as shares of the box.
PLACES, TRIES = 24, 6
FIRST, LAST = 0.2, 0.002
TURNS = 40
# Share of the tries along one parameter, and of the box within which two places are one.
ALONG, APART = 0.5, 0.05
SHOWN = 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, default=None, help="by default the shipped ones")
    parser.add_argument("--sobol", type=int, default=2048, help="shapes spread over the box at the beginning")
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--places", type=int, default=PLACES)
    parser.add_argument("--budget-s", type=float, default=float("inf"), help="stop with what is found by then")
    parser.add_argument("--batch-size", type=int, default=16)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=results_folder() / "surrogate-worst.json")
    options = parser.parse_args()
    torch.backends.cudnn.allow_tf32 = False
    file = options.weights or shipped_weights()
    if file is None:
        raise SystemExit("there are no shipped weights here: name some by --weights")
    model, facts = load_weights(file, options.device)
    record = search(model.eval(), options)
    about = {"machine": describe(options.device, ("torch",)), "weights": file.name, "training": facts.get("training")}
    write(options.out, {**about, **record})
    worst, corner = record["worst"][0], record["worst_corner"]
    print(
        f"{record['shapes']:,} shapes in {record['seconds']} s: worst Dice {worst['dice']:.4f} at {worst['theta']}; "
        f"worst corner {corner['dice']:.4f} at {corner['theta']}; "
        f"of {record['sobol']:,} spread over the box mean {record['sobol_mean']:.4f}, worst {record['sobol_worst']:.4f}"
    )


@torch.no_grad()
def search(model: torch.nn.Module, options: argparse.Namespace) -> dict[str, Any]:
    """The record of a search."""
    family, begin = Cochlea(), time.perf_counter()

    def late() -> bool:
        return time.perf_counter() - begin > options.budget_s

    def scores(theta: Tensor) -> Tensor:
        """(N,2): Dice and mean error [mm]."""
        rows = [_scores(model, batch.theta, batch.sdm) for batch in
                validation_batches(theta, options.device, options.batch_size)]  # fmt: skip
        return torch.cat(rows).cpu()

    low = torch.tensor([p.low for p in family.parameters])
    width = torch.tensor([p.high for p in family.parameters]) - low
    corners = _grid(family, 2)
    spread = family.sample(options.sobol, seed=options.seed, sampler="sobol", device="cpu")
    theta = torch.cat([corners, _grid(family, 3), spread])
    found = scores(theta)
    print(f"{len(theta):,} shapes, worst Dice {found[:, 0].min():.4f}, {time.perf_counter() - begin:.0f} s", flush=True)
    at_corners, of_spread = found[: len(corners)], found[-len(spread) :]
    count = len(theta)
    order = found[:, 0].argsort()[: options.places]
    places, best = theta[order].clone(), found[order].clone()
    random = generator(options.seed, "search for the worst shape of a surrogate")
    for turn in range(options.turns):
        if late():
            break
        length = FIRST * (LAST / FIRST) ** (turn / max(1, options.turns - 1))
        steps = torch.randn(len(places), TRIES, len(width), generator=random, device="cpu") * length
        alone = torch.nn.functional.one_hot(
            torch.randint(len(width), steps.shape[:2], generator=random, device="cpu"), len(width)
        )
        some = torch.rand(steps.shape[:2], generator=random, device="cpu") < ALONG
        steps = torch.where(some[..., None], steps * alone, steps) * width
        tries = torch.minimum(torch.maximum(places[:, None] + steps, low), low + width)
        new = scores(tries.reshape(-1, len(width))).reshape(*tries.shape[:2], 2)
        count += new[..., 0].numel()
        worse, at = new[..., 0].min(1)
        for k in range(len(places)):
            if worse[k] < best[k, 0]:
                best[k], places[k] = new[k, at[k]], tries[k, at[k]]
    lowest = int(at_corners[:, 0].argmin())
    order = best[:, 0].argsort()
    return {
        "seconds": round(time.perf_counter() - begin, 1),
        "shapes": count,
        "sobol": len(spread),
        "sobol_mean": round(float(of_spread[:, 0].mean()), 5),
        "sobol_worst": round(float(of_spread[:, 0].min()), 5),
        "worst": [_named(family, places[k], best[k]) for k in _apart(places[order], width, order)],
        "worst_corner": _named(family, corners[lowest], at_corners[lowest]),
        "corners": [_named(family, *row) for row in zip(corners, at_corners, strict=True)],
    }


def _scores(model: torch.nn.Module, theta: Tensor, exact: Tensor) -> Tensor:
    guess = model(theta).float()
    inside, wanted = (guess < 0).flatten(1), (exact < 0).flatten(1)
    dice = 2 * (inside & wanted).sum(1) / (inside.sum(1) + wanted.sum(1))
    return torch.stack([dice, (guess - exact).abs().flatten(1).mean(1)], 1)


def _grid(family: Family, points: int) -> Tensor:
    sampler = TensorGrid(points, shuffle=False)
    return sampler.theta(family, 0, torch.arange(sampler.size(family), device="cpu"))


def _apart(places: Tensor, width: Tensor, order: Tensor) -> list[int]:
    """Numbers of the worst places, without those beside a worse one."""
    kept: list[int] = []
    for k, place in enumerate(places):
        if all(float(((place - places[other]).abs() / width).amax()) > APART for other in kept):
            kept.append(k)
    return [int(order[k]) for k in kept[:SHOWN]]


def _named(family: Family, theta: Tensor, row: Tensor) -> dict[str, Any]:
    place = {p.name: round(x, 5) for p, x in zip(family.parameters, theta.tolist(), strict=True)}
    return {"theta": place, "dice": round(float(row[0]), 5), "mae_mm": round(float(row[1]), 5)}


if __name__ == "__main__":
    main()
