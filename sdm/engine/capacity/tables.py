"""The numbers that a recording of a capacity class reads from memory: a table on the host, written for each launch."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.classes import CapacityClass
from sdm.kernels.bvh.tree import PART_SIZE, TRIANGLES_PER_LEAF
from sdm.kernels.dense.plan import Decisions
from sdm.kernels.geometry.voxel_grid import AXES, CELL_SHARES, REGION_SHARES, SLAB_ROW, Slab
from sdm.kernels.launch import set_array
from sdm.kernels.topology.filler_faces import ADDRESSES, COUNTS
from sdm.runtime.torch_warp import as_warp

# The table, in numbers of 8 bytes: both slabs' rows, the addresses, then the counts and both meshes' parts as whole
# numbers, two in the room of one.
_ROWS = 2 * SLAB_ROW
_NUMBERS = COUNTS + 2 * PART_SIZE
TABLE = _ROWS + ADDRESSES + -(-_NUMBERS // 2)
# Behind origin and spacing of the mesh's row: what is nearly always the same for all meshes of a class.
_SAME_AT = AXES
_PLACE, _SAME = struct.Struct(f"={_SAME_AT}d"), struct.Struct(f"={_ROWS - _SAME_AT}d")
_REST, _REST_AT = struct.Struct(f"={ADDRESSES}q{_NUMBERS}i"), 8 * _ROWS


def write_table(
    table: memoryview,
    kind: CapacityClass,
    decisions: Decisions,
    faces: int,
    vertices: int,
    grid: Grid,
    addresses: Sequence[int],
) -> None:
    """Write what kernels read about a mesh and its grid.

    Args:
        table: Memory of TABLE numbers of 8 bytes: zeros, or what was written about another mesh of the class.
        kind: The class.
        decisions: About the mesh's map.
        faces: Of the mesh.
        vertices: Of the mesh.
        grid: Of the map.
        addresses: Where its arrays are, and where results go, see `sdm.kernels.topology.filler_faces`.
    """
    # Few numbers, as the host's way to the launch is much of a small map's time.
    shares = decisions.region_shares, decisions.cell_shares
    if kind.turned or (table[REGION_SHARES], table[CELL_SHARES]) != shares:
        axes = [0.0] * 9
        if kind.turned:
            axes = [d * s for line in grid.direction for d, s in zip(line, grid.spacing, strict=True)]
        # In the order of a row: its slab's first layer, voxel and region are the first of all. Behind it is the row of
        # a grid without voxels.
        _SAME.pack_into(table, 8 * _SAME_AT, *axes, *grid.shape, *(0, 0, 0), *shares, *kind.row_of_none)
    _PLACE.pack_into(table, 0, *grid.origin, *grid.spacing)
    # `depth_for`, without the function.
    depth = (-(-faces // TRIANGLES_PER_LEAF) - 1).bit_length()
    _REST.pack_into(
        table,
        _REST_AT,
        *addresses,
        *(faces, vertices),
        # In the order of a part: first slot, triangles, depth, first node, levels that are left out.
        *(0, faces, depth, 0, decisions.levels_left_out),
        # Of the faces behind there is a tree of the first alone, as nobody looks for any.
        *(faces, 1, 0, 2 << depth, 0),
    )


def split_table(table: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Both slabs' rows, the addresses, the counts, and both meshes' parts, of a table on the device."""
    rows, addresses, numbers = table.split([_ROWS, ADDRESSES, TABLE - _ROWS - ADDRESSES])
    counts, parts = numbers.view(torch.int32)[:_NUMBERS].split([COUNTS, 2 * PART_SIZE])
    return rows, addresses.view(torch.int64), counts, parts


def both_slabs(kind: CapacityClass, rows: Tensor) -> Any:
    """Both slabs, as kernels take them."""
    slab = Slab()
    slab.turned, slab.shape, slab.meshes = int(kind.turned), wp.vec3i(*kind.shape), 2
    set_array(slab, "rows", as_warp(rows, wp.float64))
    return slab
