"""Card of a surrogate: errors on fresh shapes, the worst case found by search, speed, error by place in the box."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.random import derive_seed, generator
from sdm.errors import SDMError
from sdm.shapes import Family
from sdm.shapes.family_check import special_theta
from sdm.surrogate.families.low_rank import LowRankSurrogate
from sdm.surrogate.families.train_family import exact_maps
from sdm.surrogate.infer.runtime import available, runner

FRESH = 128
# Half-width of the shell called near the surface, in voxels.
NEAR = 2.5
# The search: so many of the worst fresh shapes go on, by ever smaller random steps.
STARTS, ROUNDS, TRIES, FIRST, LAST = 4, 12, 4, 0.3, 0.01
BINS = 5
CALLS = 20

Surrogate = Callable[[Tensor], Tensor]


def measure_card(
    model: LowRankSurrogate,
    family: Family,
    grid: Grid,
    *,
    fresh: int = FRESH,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> dict[str, Any]:
    """The card, ready for JSON; lengths in the family's unit.

    Args:
        model: On the host.
        family: What it stands for.
        grid: Where it answers.
        fresh: How many shapes that the training has not seen.
        seed: Of these.
        device: Where exact maps are made.

    `worst` has the lowest Dice coefficient and the largest mean error that a search over the box found: it begins at
    the corners (up to 64), the centre and the fresh shapes, and goes on from the worst by random steps that shrink.
    Those are places where the surrogate is bad, not a proof that it is nowhere worse.
    """
    where = torch.device(device)

    def rows(theta: Tensor) -> Tensor:
        return torch.cat([_errors(model, family, part, grid, where) for part in theta.split(16)])

    theta = family.sample(fresh, seed=derive_seed(seed, "fresh shapes of a surrogate's card"), device="cpu")
    found = rows(theta)
    corners = special_theta(family)
    every, all_theta = torch.cat([found, rows(corners)]), torch.cat([theta, corners])
    worst = {}
    for name, column, sign in (("dice", 3, -1.0), ("mean", 0, 1.0)):
        place, row = _search(rows, family, all_theta, every, column, sign, seed)
        worst[name] = {
            "theta": {p.name: round(x, 6) for p, x in zip(family.parameters, place.tolist(), strict=True)},
            **_named(row),
        }
    reach = (2 * _box_unit(family, all_theta) - 1).abs().amax(1)
    bins = []
    for k in range(BINS):
        here = (reach >= k / BINS) & (reach <= (k + 1) / BINS)
        if bool(here.any()):
            own = every[here]
            bins.append({"from": k / BINS, "to": (k + 1) / BINS, "shapes": len(own), "mean": _round(own[:, 0].mean())})
    return {
        "fresh": fresh,
        "voxel": grid.spacing[0],
        "mean": _round(found[:, 0].mean()),
        "near": _round(found[:, 1].nanmean()),
        "largest": _round(found[:, 2].max()),
        "dice": _round(found[:, 3].nanmean()),
        "dice_least": _round(found[:, 3].nan_to_num(1).min()),
        "worst": worst,
        "by_distance_from_centre": bins,
        "speed": _speeds(model, family, grid, where),
    }


def _errors(model: LowRankSurrogate, family: Family, theta: Tensor, grid: Grid, device: torch.device) -> Tensor:
    """(B,4) mean, near and largest absolute error, and Dice; NaN of a shape without a voxel inside."""
    exact = exact_maps(family, theta, grid, device).cpu().flatten(1)
    with torch.no_grad():
        guess = model(theta).flatten(1)
    error = (guess - exact).abs()
    near = exact.abs() < NEAR * max(grid.spacing)
    inside, wanted = guess < 0, exact < 0
    dice = 2 * (inside & wanted).sum(1) / (inside.sum(1) + wanted.sum(1))
    return torch.stack([error.mean(1), (error * near).sum(1) / near.sum(1), error.amax(1), dice], 1)


def _search(
    rows: Callable[[Tensor], Tensor],
    family: Family,
    theta: Tensor,
    known: Tensor,
    column: int,
    sign: float,
    seed: int,
) -> tuple[Tensor, Tensor]:
    """The worst place and its errors."""
    random = generator(seed, "search for a surrogate's worst case", column)
    low = torch.tensor([p.low for p in family.parameters], device="cpu")
    width = torch.tensor([p.high for p in family.parameters], device="cpu") - low
    score = (sign * known[:, column]).nan_to_num(-torch.inf)
    order = score.argsort(descending=True)[:STARTS]
    places, errors, best = theta[order].clone(), known[order].clone(), score[order].clone()
    for turn in range(ROUNDS):
        size = FIRST * (LAST / FIRST) ** (turn / (ROUNDS - 1))
        steps = torch.randn(len(places), TRIES, len(width), generator=random, device="cpu") * size * width
        tries = torch.minimum(torch.maximum(places[:, None] + steps, low), low + width)
        found = rows(tries.reshape(-1, len(width))).reshape(len(places), TRIES, -1)
        worse, at = (sign * found[..., column]).nan_to_num(-torch.inf).max(1)
        for k in range(len(places)):
            if worse[k] > best[k]:
                best[k], places[k], errors[k] = worse[k], tries[k, at[k]], found[k, at[k]]
    top = int(best.argmax())
    return places[top], errors[top]


def _speeds(model: LowRankSurrogate, family: Family, grid: Grid, device: torch.device) -> dict[str, Any]:
    """Milliseconds of one map: of each backend that is installed, on the host, and of the exact engine."""
    theta = family.sample(1, seed=7, device="cpu")
    found: dict[str, Any] = {}
    for name in available():
        try:
            run = runner(model, name)
            run(theta)
        except (SDMError, RuntimeError) as error:
            # The exporter's messages have colours, and its advice after them.
            said = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()[0]
            found[name] = f"does not run: {said.split(' This is step')[0]}"
            continue
        found[name] = _milliseconds(lambda run=run: run(theta))
    found[f"exact on {device.type}"] = _milliseconds(lambda: exact_maps(family, theta, grid, device).cpu())
    return found


def _milliseconds(call: Callable[[], Any]) -> float:
    call()
    times = []
    for _ in range(CALLS):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return round(1000 * sorted(times)[CALLS // 2], 3)


def _box_unit(family: Family, theta: Tensor) -> Tensor:
    low = torch.tensor([p.low for p in family.parameters], device="cpu")
    high = torch.tensor([p.high for p in family.parameters], device="cpu")
    return (theta - low) / (high - low).clamp_min(1e-12)


def _named(row: Tensor) -> dict[str, float]:
    return {name: _round(x) for name, x in zip(("mean", "near", "largest", "dice"), row, strict=True)}


def _round(value: Tensor) -> float:
    return float(f"{float(value):.5g}")
