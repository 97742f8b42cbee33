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
SWAPPED = (
    "with x and z swapped it lies inside: the mesh seems to have the order of an array's axes, z, y, x; "
    "turn the columns of its vertices round"
)
# The order in which x, y and z are taken, their factors, and what to say if that brings a mesh into its grid.
MISTAKES = (
    ((0, 1, 2), (-1.0, -1.0, 1.0), LPS),
    ((0, 1, 2), (1e3, 1e3, 1e3), METRES),
    ((0, 1, 2), (1e-3, 1e-3, 1e-3), MILLIMETRES),
    ((2, 1, 0), (1.0, 1.0, 1.0), SWAPPED),
)
# A voxel has this many times the length of a float32 step at least where coordinates tell it from its neighbour well.
STEPS_IN_A_VOXEL = 8


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
    for order, factors, sentence in MISTAKES:
        corners = [np.multiply(corner[list(order)], factors) for corner in (low, high)]
        if _lies_within(*_in_voxels(corners[0], corners[1], grid), grid):
            return [f"no voxel is inside: the mesh's box, {_box(low, high)}, {_where(meets, grid)}, but {sentence}"]
    if not meets:
        return [f"no voxel is inside: the mesh's box, {_box(low, high)}, {_where(meets, grid)}"]
    # Of the eight corners of a box around it none can be inside.
    if (end - begin).max() < TINY and max(grid.shape) > 2:
        return [f"no voxel is inside: the mesh's box, {_box(low, high)}, is smaller than a voxel; use a finer grid"]
    return []


def misses(low: Float64[np.ndarray, " 3"], high: Float64[np.ndarray, " 3"], grid: Grid) -> bool:
    """True if the box of a mesh lies wholly outside a grid, which then has nothing inside."""
    return not _meets(*_in_voxels(low, high, grid), grid)


def points_problems(
    low: Float64[np.ndarray, " 3"],
    high: Float64[np.ndarray, " 3"],
    begin: Float64[np.ndarray, " 3"],
    end: Float64[np.ndarray, " 3"],
) -> list[str]:
    """Sentences, one at most, about the box of a mesh that has none of many points inside.

    Args:
        low: (3,) least coordinates of the mesh.
        high: (3,) largest ones.
        begin: (3,) least coordinates of the points.
        end: (3,) largest ones.

    Points may well lie all on one side of a mesh, so nothing is said unless axes or unit explain it.
    """
    edge = float((end - begin).max())
    if not np.isfinite(edge) or edge <= 0:
        return []
    # As if they were corners of voxels, of which the longest edge has 64.
    shape = np.ceil((end - begin) / edge * 63).astype(int) + 1
    found = placement_problems(low, high, Grid(begin, (edge / 63,) * 3, shape))
    if not found or ", but " not in found[0]:
        return []
    text = found[0].replace("is a few voxels large at most", "is tiny beside that of the points")
    for word, other in (("voxel", "point"), ("the grid's", "that of the points"), ("the grid", "the points")):
        text = text.replace(word, other)
    return [text]


def too_large_for(low: Float64[np.ndarray, " 3"], high: Float64[np.ndarray, " 3"], grid: Grid) -> list[str]:
    """Sentences, one at most, about the box of a mesh that has every voxel of a grid inside."""
    begin, end = _in_voxels(low, high, grid)
    if not (begin <= -0.5).all() or not (end >= np.asarray(grid.shape) - 0.5).all():
        return []
    if not _lies_within(*_in_voxels(low / 1000, high / 1000, grid), grid):
        return []
    return [f"every voxel is inside: the mesh's box, {_box(low, high)}, is larger than the grid, but {MILLIMETRES}"]


def rounding_problems(grid: Grid) -> list[str]:
    """Sentences, one at most, about a grid, and so a mesh, too far from the origin for float32 to tell voxels apart.

    Of the mesh nothing is read: on a GPU that would wait.
    """
    voxel = min(grid.spacing)
    bound = max(abs(x) + s * n for x, s, n in zip(grid.origin, grid.spacing, grid.shape, strict=True))
    if _step(bound) * STEPS_IN_A_VOXEL <= voxel:
        return []
    largest = float(np.abs(_bounds_of(grid)).max())
    step = _step(largest)
    if step * STEPS_IN_A_VOXEL <= voxel:
        return []
    text = (
        f"coordinates of up to {largest:.4g} have steps of {step:.2g} in float32, and voxels are {voxel:.2g}: digits "
        "are lost; move mesh and grid towards the origin before they become float32"
    )
    return [text]


def _step(coordinate: float) -> float:
    """The distance of float32 numbers at a coordinate."""
    return float(np.spacing(np.float32(coordinate)))


def thinness(low: Float64[np.ndarray, " 3"], high: Float64[np.ndarray, " 3"], grid: Grid) -> str | None:
    """Said of a box of coordinates within a grid that is thinner than a voxel along an axis, and not flat."""
    begin, end = _in_voxels(low, high, grid)
    size = end - begin
    if not ((begin >= -0.5) & (end <= np.asarray(grid.shape) - 0.5)).all() or not 0 < size.min() < TINY:
        return None
    # Of the eight corners of a box around it none can be inside.
    if max(grid.shape) <= 2:
        return None
    axis = int(size.argmin())
    return (
        f"no voxel is inside: the mesh is {size[axis] * grid.spacing[axis]:.3g} thick along {'xyz'[axis]}, and the "
        f"voxels are {grid.spacing[axis]:.3g}; use a finer grid"
    )


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
