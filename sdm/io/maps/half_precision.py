"""Range of half precision: which distances it has numbers for."""

from __future__ import annotations

import math

import torch

from sdm.core.grid import Grid
from sdm.errors import SDMError

LARGEST = torch.finfo(torch.float16).max
# Of numbers near zero.
STEP = torch.finfo(torch.float16).smallest_normal * torch.finfo(torch.float16).eps
# Steps that a voxel is to be wide at least, so that the surface does not move by much of a voxel.
FEWEST_STEPS = 16


def diagonal_of(grid: Grid) -> float:
    """Distance between opposite corners of a grid: no voxel is further from a surface within it."""
    return math.hypot(*(s * (n - 1) for s, n in zip(grid.spacing, grid.shape, strict=True)))


def require_half_range(grid: Grid, reach: float, truncate: float | None, instead: str) -> None:
    """Refuse maps that float16 has no numbers for: it ends, and near zero its steps are coarse.

    Args:
        grid: Of the maps.
        reach: Length that no distance exceeds.
        truncate: Length at which distances are cut, if they are.
        instead: What to do about distances that are too large, as the sentence says it.

    Raises:
        SDMError: Distances may be infinite, or voxels are hardly wider than a step.
    """
    if min(reach, math.inf if truncate is None else truncate) > LARGEST:
        raise SDMError(
            f"distances on this grid may reach {reach:g}, but float16 ends at {LARGEST:g}: use float32, {instead}"
        )
    least = min(*grid.spacing, math.inf if truncate is None else truncate)
    if least < FEWEST_STEPS * STEP:
        cut = truncate is not None and truncate == least
        what, better = ("distances", "truncate to more") if cut else ("voxels", "another unit of length")
        raise SDMError(
            f"{what} of {least:g} are too small for float16, whose steps are {STEP:.2g}: use float32, or {better}"
        )
