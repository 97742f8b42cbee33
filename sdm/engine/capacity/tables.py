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
from sdm.kernels.bvh.tree import COUNT, DEPTH, FIRST, LEFT_OUT, PART_SIZE, ROOT, depth_for
from sdm.kernels.dense.plan import Decisions
from sdm.kernels.geometry.voxel_grid import (
    AXES,
    CELL_SHARES,
    ORIGIN,
    REGION,
    REGION_SHARES,
    SHAPE,
    SLAB_ROW,
    SPACING,
    VOXEL,
    Slab,
)
from sdm.kernels.launch import set_array
from sdm.kernels.topology.filler_faces import ADDRESSES, COUNTS, FACES, VERTICES
from sdm.runtime.torch_warp import as_warp

# The table, in numbers of 8 bytes: both slabs' rows, the addresses, then the counts and both meshes' parts as whole
# numbers, two in the room of one.
_ROWS = 2 * SLAB_ROW
_NUMBERS = COUNTS + 2 * PART_SIZE
TABLE = _ROWS + ADDRESSES + -(-_NUMBERS // 2)
_FORMAT = struct.Struct(f"={_ROWS}d{ADDRESSES}q{_NUMBERS}i")


def write_table(
    table: Any,
    kind: CapacityClass,
    decisions: Decisions,
    faces: int,
    vertices: int,
    grid: Grid,
    addresses: Sequence[int],
) -> None:
    """Write what kernels read about a mesh and its grid.

    Args:
        table: Memory of TABLE numbers of 8 bytes.
        kind: The class.
        decisions: About the mesh's map.
        faces: Of the mesh.
        vertices: Of the mesh.
        grid: Of the map.
        addresses: Where its arrays are, and where results go, see `sdm.kernels.topology.filler_faces`.
    """
    # Lists, as NumPy takes longer to write a few numbers than all else here.
    own: list[float] = [0.0] * SLAB_ROW
    own[ORIGIN : ORIGIN + 3], own[SPACING : SPACING + 3], own[SHAPE : SHAPE + 3] = grid.origin, grid.spacing, grid.shape
    own[REGION_SHARES], own[CELL_SHARES] = decisions.region_shares, decisions.cell_shares
    if kind.turned:
        own[AXES : AXES + 9] = [d * s for line in grid.direction for d, s in zip(line, grid.spacing, strict=True)]
    # A grid without voxels, behind the other.
    none: list[float] = [0.0] * SLAB_ROW
    none[SPACING : SPACING + 3], none[VOXEL], none[REGION] = (1.0, 1.0, 1.0), grid.size, kind.plan.total
    none[REGION_SHARES], none[CELL_SHARES] = kind.plan.region_shares, kind.plan.cell_shares
    depth = depth_for(faces)
    parts = [0] * (2 * PART_SIZE)
    parts[COUNT], parts[DEPTH], parts[LEFT_OUT] = faces, depth, decisions.levels_left_out
    # Of the faces behind there is a tree of the first alone, as nobody looks for any.
    parts[PART_SIZE + FIRST], parts[PART_SIZE + COUNT], parts[PART_SIZE + ROOT] = faces, 1, 2 << depth
    counts = [0] * COUNTS
    counts[FACES], counts[VERTICES] = faces, vertices
    _FORMAT.pack_into(table, 0, *own, *none, *addresses, *counts, *parts)


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
