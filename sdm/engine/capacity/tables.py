"""The numbers that a recording of a capacity class reads from memory, and inputs that fill its room."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.classes import CapacityClass
from sdm.kernels.bvh.tree import COUNT, DEPTH, FIRST, LEFT_OUT, PART_SIZE, ROOT, depth_for
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
from sdm.kernels.topology.filler_faces import COUNTS, FACES, VERTICES
from sdm.runtime.graphs import Call
from sdm.runtime.torch_warp import as_warp

# The table: both slabs' rows, then the counts and both meshes' parts as whole numbers, two in the room of a row's.
_ROWS = 2 * SLAB_ROW
_NUMBERS = COUNTS + 2 * PART_SIZE
TABLE = _ROWS + -(-_NUMBERS // 2)
_FORMAT = struct.Struct(f"={_ROWS}d{_NUMBERS}i")


def class_inputs(kind: CapacityClass, vertices: Tensor, faces: Tensor, grid: Grid) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs of a call: with as many rows as the mesh, and the table on the host; `to_record` has a recording's."""
    table = torch.empty(TABLE, dtype=torch.float64, pin_memory=faces.is_cuda)
    write_table(table.numpy(), kind, faces.shape[0], vertices.shape[0], grid)
    return vertices, faces, table


def to_record(kind: CapacityClass, call: Call) -> Call:
    """The same call, whose inputs fill the room of its class."""
    vertices, faces, table = call.inputs
    inputs = _longer(vertices, kind.vertices), _longer(faces, kind.faces), table.to(faces.device)
    return Call(call.key, call.work, inputs, is_for_many=True)


def _longer(given: Tensor, rows: int) -> Tensor:
    found = given.new_zeros((rows, given.shape[1]))
    found[: given.shape[0]] = given
    return found


def write_table(table: np.ndarray, kind: CapacityClass, faces: int, vertices: int, grid: Grid) -> None:
    """Write the numbers that kernels read about a mesh and its grid: (TABLE,) float64."""
    # Lists, as NumPy takes longer to write a few numbers than all else here.
    own: list[float] = [0.0] * SLAB_ROW
    own[ORIGIN : ORIGIN + 3], own[SPACING : SPACING + 3], own[SHAPE : SHAPE + 3] = grid.origin, grid.spacing, grid.shape
    own[REGION_SHARES], own[CELL_SHARES] = kind.plan.region_shares, kind.plan.cell_shares
    if kind.turned:
        own[AXES : AXES + 9] = [d * s for line in grid.direction for d, s in zip(line, grid.spacing, strict=True)]
    # A grid without voxels, behind the other.
    none: list[float] = [0.0] * SLAB_ROW
    none[SPACING : SPACING + 3], none[VOXEL], none[REGION] = (1.0, 1.0, 1.0), grid.size, kind.plan.total
    none[REGION_SHARES], none[CELL_SHARES] = kind.plan.region_shares, kind.plan.cell_shares
    depth, behind = depth_for(faces), kind.faces - faces
    parts = [0] * (2 * PART_SIZE)
    parts[COUNT], parts[DEPTH], parts[LEFT_OUT] = faces, depth, kind.plan.levels_left_out
    parts[PART_SIZE + FIRST], parts[PART_SIZE + COUNT] = faces, behind
    parts[PART_SIZE + DEPTH], parts[PART_SIZE + ROOT] = depth_for(behind), 2 << depth
    counts = [0] * COUNTS
    counts[FACES], counts[VERTICES] = faces, vertices
    _FORMAT.pack_into(table.data, 0, *own, *none, *counts, *parts)


def split_table(table: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Both slabs' rows, the counts, and both meshes' parts, of a table on the device."""
    counts, parts = table[_ROWS:].view(torch.int32)[:_NUMBERS].split([COUNTS, 2 * PART_SIZE])
    return table[:_ROWS], counts, parts


def both_slabs(kind: CapacityClass, rows: Tensor) -> Any:
    """Both slabs, as kernels take them."""
    slab = Slab()
    slab.turned, slab.shape, slab.meshes = int(kind.turned), wp.vec3i(*kind.shape), 2
    set_array(slab, "rows", as_warp(rows, wp.float64))
    return slab
