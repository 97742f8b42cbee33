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
# Of a grid of fewer voxels a CPU makes the map in less time than the band.
LARGEST_MAP = 1 << 26
# So many times a band's half width are the voxels along the shortest axis of a grid for which it is worth while.
SHARE = 16
# For rounding.
SAFETY = 1.01


def closing_field(index: MeshIndex, grid: Grid, sign: Sign, hole_size: float | None, level: float) -> SDM | SparseSDM:
    """The distances around the surface at a level.

    A band has all voxels at which that surface is, also where a flood ends in an opening that it does not pass: there
    one of two neighbours is nearer to the mesh or to a hole's cap than where the ball moves freely (see
    `sdm.engine.band.flood_bands`), and a cap is at most half the hole size from its rim.

    Raises:
        GridError: Neither fits into memory.
    """
    diagonal = math.hypot(*grid.spacing)
    width = SAFETY * max(level + 2 * diagonal, 0.0 if hole_size is None else hole_size + 3 * diagonal)
    half_width = width / max(grid.spacing)
    needed, free = BYTES * grid.size, free_memory(index.device)
    wide = SHARE * half_width > min(grid.shape)
    # On a GPU, where bands by a flood were not timed, a map that fits is taken.
    if needed <= free and (index.device.type != "cpu" or grid.size <= LARGEST_MAP or wide):
        return index.signed_distance_map(grid, sign=sign, hole_size=hole_size)
    if wide:
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
