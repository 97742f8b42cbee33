"""Map or narrow band of which a closed surface is the level set: a band where it is smaller, with the same surface."""

from __future__ import annotations

import math

from sdm.core.device import free_memory
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.engine.arguments import Sign
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import GridError

# Bytes a voxel: the map, its copy, and what a flood takes.
BYTES = 16
# Of a grid with fewer voxels along its shortest axis, for each voxel of a band's half width, the whole map is made.
SHARE = 16
# For rounding.
ROOM = 1.01


def closing_field(index: MeshIndex, grid: Grid, sign: Sign, hole_size: float | None, level: float) -> SDM | SparseSDM:
    """The distances around the surface at a level.

    A band has all voxels at which that surface is, also where a flood ends in an opening that it does not pass: there
    one of two neighbours is nearer to the mesh or to a hole's cap than where the ball moves freely (see
    `sdm.engine.band.flood_bands`), and a cap is at most half the hole size from its rim.

    Raises:
        GridError: Neither fits into memory.
    """
    diagonal = math.hypot(*grid.spacing)
    width = ROOM * max(level + 2 * diagonal, 0.0 if hole_size is None else hole_size + 3 * diagonal)
    half_width = width / max(grid.spacing)
    needed, free = BYTES * grid.size, free_memory(index.device)
    # On a GPU a map is one recorded call after the other.
    fits = needed <= free
    if fits and (index.device.type != "cpu" or SHARE * half_width > min(grid.shape)):
        return index.signed_distance_map(grid, sign=sign, hole_size=hole_size)
    if SHARE * half_width > 4 * min(grid.shape):
        raise GridError(
            f"a closed surface by {grid.summary} needs about {needed / 2**30:.1f} GiB, but {index.device} has "
            f"{free / 2**30:.1f} GiB free; choose a lower resolution"
        )
    return index.narrow_band(grid, half_width=half_width, sign=sign, hole_size=hole_size)


def with_zeros_inside(field: SDM | SparseSDM, small: float) -> SDM | SparseSDM:
    """The same with minus a small length at voxels on hidden faces: they are inside, though their distance is zero."""
    field.values.masked_fill_((field.values == 0) & field.values.signbit(), -small)
    return field


def is_reached(field: SDM | SparseSDM, level: float) -> bool:
    """True if some voxel is below a level."""
    hidden = isinstance(field, SparseSDM) and len(field.inside) > 0
    return hidden or bool((field.values < level).any())
