"""Limits of a right answer: the error allowed, its unit (a float32 rounding), and the signs that are compared."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import sdm
from sdm.bench.common.meshes import Case

# Float32's unit of rounding: a coordinate x is stored to within this times |x|.
UNIT = 2.0**-24
# Most roundings that a distance may be off.
LIMIT = 4.0
# Signs are compared where the winding number is further than this from one half ...
WINDING_BAND = 1e-3
INSIDE = 0.5
# ... and where it stays on its side if the point moves by this share of a rounding, in each of 26 directions.
MOVE = 0.25


def voxel_centres(grid: sdm.Grid, which: np.ndarray | None = None) -> np.ndarray:
    """Centres (n,3) float32 of the voxels of a grid with these numbers: rows of `grid.points()`."""
    if which is None:
        return grid.points().numpy().reshape(-1, 3)
    i, j, k = np.unravel_index(which, grid.shape)
    rows = np.asarray(grid.direction) * np.asarray(grid.spacing)
    # Added in the order of `grid.points()`, as each sum is rounded.
    return np.stack(
        [origin + (row[0] * i + row[1] * j + row[2] * k) for origin, row in zip(grid.origin, rows, strict=True)], -1
    ).astype(np.float32)


def rounding(case: Case, points: np.ndarray) -> np.ndarray:
    """One rounding at the scale of the coordinates, for each of points (N,3).

    2^-24 times the largest absolute coordinate of the mesh and of that point.
    """
    low, high = case.box
    mesh = max(np.abs(low).max(), np.abs(high).max())
    return UNIT * np.maximum(mesh, np.abs(points.astype(np.float64)).max(1))


def firm_winding(case: Case, points: np.ndarray, winding_number: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Winding numbers (N,) of points (N,3), and `INSIDE`, that is unclear, where they do not stay on their side.

    A few roundings from an edge that faces share unevenly the winding number changes by a tenth within a rounding. An
    engine that keeps edges on a lattice, however fine, then has the sign of a point beside the one that was asked for.
    """
    winding = winding_number(points)
    steps = np.array([step for step in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(step)])
    steps *= MOVE / np.linalg.norm(steps, axis=1, keepdims=True)
    moved = points.astype(np.float64) + steps[:, None] * rounding(case, points)[:, None]
    sides = winding_number(moved.reshape(-1, 3)).reshape(len(steps), -1) > INSIDE
    return np.where((sides == (winding > INSIDE)).all(0), winding, INSIDE)


@dataclass
class Tally:
    """Errors of one set of values against the truth.

    `max_error` is in roundings; values that are not finite count as infinitely wrong. A sign is compared where the
    winding number is clear and the distance above the limit (... and not on the surface); `unclear` and `on_surface`
    count the points left out of that, in this order.
    """

    points: int
    max_error: float
    over_limit: int
    wrong_signs: int
    unclear: int
    on_surface: int
    worst_point: list[float]

    @property
    def fine(self) -> bool:
        """True if no limit is broken."""
        return self.over_limit == 0 and self.wrong_signs == 0

    def as_dict(self) -> dict[str, Any]:
        """For a JSON file; infinity has no place there."""
        return asdict(self) | {"max_error": self.max_error if np.isfinite(self.max_error) else None}


def compare(
    case: Case, points: np.ndarray, values: np.ndarray, distance: np.ndarray, winding: np.ndarray | None
) -> Tally:
    """Compare signed distances `values` (N,) at `points` (N,3) with the true distances and winding numbers (N,).

    Without winding numbers signs are not compared.
    """
    values = values.astype(np.float64)
    unit = rounding(case, points)
    with np.errstate(invalid="ignore"):
        error = np.abs(np.abs(values) - distance) / unit
    error = np.where(np.isfinite(values), error, np.inf)
    wrong = unclear = on_surface = np.zeros(len(values), bool)
    if winding is not None:
        unclear = np.abs(winding - INSIDE) <= WINDING_BAND
        on_surface = ~unclear & (distance <= LIMIT * unit)
        wrong = ((values < 0) != (winding > INSIDE)) & ~unclear & ~on_surface
    broken = wrong | (error > LIMIT)
    worst = np.where(wrong, np.inf, error).argmax() if len(error) else 0
    return Tally(
        points=len(values),
        max_error=float(error.max(initial=0.0)),
        over_limit=int((error > LIMIT).sum()),
        wrong_signs=int(wrong.sum()),
        unclear=int(unclear.sum()),
        on_surface=int(on_surface.sum()),
        worst_point=[float(x) for x in points[worst]] if broken.any() else [],
    )
