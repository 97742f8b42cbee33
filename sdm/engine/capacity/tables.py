"""The numbers that a recording of a capacity class reads from memory: a table on the host, written for each launch."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.classes import CapacityClass
from sdm.kernels.bvh.tree import PART_SIZE, depth_for
from sdm.kernels.dense.plan import Decisions
from sdm.kernels.geometry.voxel_grid import CELL_SHARES, REGION, REGION_SHARES, SLAB_ROW, SPACING, VOXEL, Slab
from sdm.kernels.launch import set_array
from sdm.kernels.topology.filler_faces import ADDRESSES, COUNTS
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
    # Few calls, as the host's way to the launch is much of a small map's time.
    axes = _ALONG
    if kind.turned:
        axes = [d * s for line in grid.direction for d, s in zip(line, grid.spacing, strict=True)]
    of_kind = kind.__dict__.get("_table") or _of_kind(kind)
    depth = depth_for(faces)
    _FORMAT.pack_into(
        table,
        0,
        # In the order of a row: its slab's first layer, voxel and region are the first of all.
        *grid.origin,
        *grid.spacing,
        *axes,
        *grid.shape,
        *(0, 0, 0, decisions.region_shares, decisions.cell_shares),
        # A grid without voxels, behind the other.
        *of_kind,
        *addresses,
        *(faces, vertices),
        # In the order of a part: first slot, triangles, depth, first node, levels that are left out.
        *(0, faces, depth, 0, decisions.levels_left_out),
        # Of the faces behind there is a tree of the first alone, as nobody looks for any.
        *(faces, 1, 0, 2 << depth, 0),
    )


_ALONG = (0.0,) * 9


def _of_kind(kind: CapacityClass) -> list[float]:
    """The row of the grid without voxels, the same for all meshes of a class."""
    none: list[float] = [0.0] * SLAB_ROW
    none[SPACING : SPACING + 3], none[VOXEL], none[REGION] = (1.0, 1.0, 1.0), math.prod(kind.shape), kind.plan.total
    none[REGION_SHARES], none[CELL_SHARES] = kind.plan.region_shares, kind.plan.cell_shares
    # It goes with the class.
    kind.__dict__["_table"] = none
    return none


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
