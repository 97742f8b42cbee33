"""Placement of a mesh beside a grid: meshes that miss it because of their axes or their unit."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from sdm.core.grid import Grid

# Voxels along its longest edge that a mesh has at least once its axes and unit are right; below the second number it
# is between the voxels' centres.
FEWEST_VOXELS, TINY = 4.0, 1.0
# The share of a mesh's box that lies in the grid then, along each axis.
WITHIN = 0.5

LPS = (
    "with x and y negated it lies inside: the mesh seems to be in LPS coordinates and the grid in RAS; "
    "negate x and y of the vertices (--mesh-space lps)"
)
METRES = (
    "times 1000 it lies inside: the mesh seems to be in metres and the grid in millimetres; "
    "multiply the vertices by 1000 (--scale 1000)"
)
MILLIMETRES = (
    "divided by 1000 it lies inside: the mesh seems to be in millimetres and the grid in metres; "
    "divide the vertices by 1000 (--scale 0.001)"
)
# Factors of x, y and z, and what to say if they bring a mesh into its grid.
MISTAKES = (
    ((-1.0, -1.0, 1.0), LPS),
    ((1e3, 1e3, 1e3), METRES),
    ((1e-3, 1e-3, 1e-3), MILLIMETRES),
)


def placement_problems(low: Float64[np.ndarray, " 3"], high: Float64[np.ndarray, " 3"], grid: Grid) -> list[str]:
    """Sentences, one at most, about the box of a mesh that has no voxel of a grid inside.

    Args:
        low: (3,) least coordinates of the mesh.
        high: (3,) largest ones.
        grid: The grid. A mesh that meets it and is not tiny beside it is none of the cases here.
    """
    begin, end = _in_voxels(low, high, grid)
    meets = _meets(begin, end, grid)
    if meets and (end - begin).max() >= FEWEST_VOXELS:
        return []
    for factors, sentence in MISTAKES:
        if _lies_within(*_in_voxels(np.multiply(low, factors), np.multiply(high, factors), grid), grid):
            return [f"no voxel is inside: the mesh's box, {_box(low, high)}, {_where(meets, grid)}, but {sentence}"]
    if not meets:
        return [f"no voxel is inside: the mesh's box, {_box(low, high)}, {_where(meets, grid)}"]
    # Of the eight corners of a box around it none can be inside.
    if (end - begin).max() < TINY and max(grid.shape) > 2:
        return [f"no voxel is inside: the mesh's box, {_box(low, high)}, is smaller than a voxel; use a finer grid"]
    return []


def resolves(low: Float64[np.ndarray, " 3"], high: Float64[np.ndarray, " 3"], grid: Grid) -> bool:
    """True if a box of coordinates lies within a grid's outermost voxels, and is some voxels wide along every axis."""
    begin, end = _in_voxels(low, high, grid)
    within = (begin >= -0.5) & (end <= np.asarray(grid.shape) - 0.5) & (end - begin >= FEWEST_VOXELS)
    return bool(within.all())


def _where(meets: bool, grid: Grid) -> str:
    if meets:
        return "is a few voxels large at most"
    low, high = _bounds_of(grid)
    return f"lies wholly outside the grid's, {_box(low, high)}"


def _in_voxels(low: np.ndarray, high: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """The box, in voxels of the grid, of a box of coordinates."""
    corners = np.array(np.meshgrid(*np.stack([low, high], 1), indexing="ij")).reshape(3, -1)
    index = np.linalg.solve(grid.affine[:3, :3], corners - np.asarray(grid.origin)[:, None])
    return index.min(1), index.max(1)


def _meets(begin: np.ndarray, end: np.ndarray, grid: Grid) -> bool:
    return bool(((end >= -0.5) & (begin <= np.asarray(grid.shape) - 0.5)).all())


def _lies_within(begin: np.ndarray, end: np.ndarray, grid: Grid) -> bool:
    shared = np.minimum(end, np.asarray(grid.shape) - 0.5) - np.maximum(begin, -0.5)
    size = end - begin
    return bool((shared >= WITHIN * size).all() and (shared >= 0).all() and size.max() >= FEWEST_VOXELS)


def _bounds_of(grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    last = np.asarray(grid.shape) - 1
    corners = np.array(np.meshgrid(*((0, n) for n in last), indexing="ij")).reshape(3, -1)
    places = grid.affine[:3, :3] @ corners + np.asarray(grid.origin)[:, None]
    return places.min(1), places.max(1)


def _box(low: np.ndarray, high: np.ndarray) -> str:
    return " to ".join("(" + ", ".join(f"{x:.4g}" for x in corner) + ")" for corner in (low, high))
