"""Maps by capacity class: a closed mesh is one of two that differ, and the faces behind its own are the other.

So the kernels for meshes that differ (`sdm.engine.ragged`) do all the work, and a map is bit for bit that of a call
for its counts. The second mesh has faces of no area and a grid without voxels.
"""

from __future__ import annotations

import struct
from functools import partial
from typing import Any, cast

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.acceleration import AccelerationStructure, Sizes, fill_surface
from sdm.engine.capacity.classes import CapacityClass
from sdm.kernels.bvh.tree import COUNT, DEPTH, FIRST, LEFT_OUT, PART_SIZE, ROOT, coarser, depth_for
from sdm.kernels.dense.query import Surface, Target, output_of, run_stages
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
from sdm.kernels.topology.filler_faces import COUNTS, FACES, VERTICES, fill_up
from sdm.kernels.winding.column_sums import slab_winding
from sdm.runtime.graphs import Call, Verify
from sdm.runtime.graphs.branches import beside, kernels_beside
from sdm.runtime.graphs.output_slot import current_slot
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace
from sdm.topology.face_pairing import queue_pairing

# The table: both slabs' rows, then the counts and both meshes' parts as whole numbers, two in the room of a row's.
_ROWS = 2 * SLAB_ROW
_NUMBERS = COUNTS + 2 * PART_SIZE
TABLE = _ROWS + -(-_NUMBERS // 2)
_FORMAT = struct.Struct(f"={_ROWS}d{_NUMBERS}i")


def class_key(kind: CapacityClass) -> tuple[str, CapacityClass]:
    """The key of the calls of a class."""
    return "class", kind


def class_call(kind: CapacityClass, vertices: Tensor, faces: Tensor, grid: Grid) -> Call:
    """The call that makes the map (1,nx,ny,nz) of a mesh, if it is closed, and the faces' neighbours (F,4).

    Its inputs have as many rows as the mesh, and the last is on the host; `to_record` has those of a recording.
    """
    table = torch.empty(TABLE, dtype=torch.float64, pin_memory=faces.is_cuda)
    write_table(table.numpy(), kind, faces.shape[0], vertices.shape[0], grid)
    return Call(class_key(kind), partial(_queue_class_map, kind), (vertices, faces, table))


def to_record(kind: CapacityClass, call: Call) -> Call:
    """The same call, whose inputs fill the room of its class."""
    vertices, faces, table = call.inputs
    inputs = _longer(vertices, kind.vertices), _longer(faces, kind.faces), table.to(faces.device)
    return Call(call.key, call.work, inputs)


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


def _queue_class_map(
    kind: CapacityClass, verify: Verify, vertices: Tensor, given: Tensor, table: Tensor
) -> tuple[Tensor, Tensor]:
    device = vertices.device
    rows, (counts, parts) = table[:_ROWS], table[_ROWS:].view(torch.int32)[:_NUMBERS].split([COUNTS, 2 * PART_SIZE])
    faces, wrong = torch.empty_like(given), torch.zeros(1, dtype=torch.int32, device=device)
    with on_current_stream(vertices, given, table):
        fill_up(*(as_warp(tensor, wp.int32) for tensor in (counts, given, faces, wrong)))
    with beside(device) as join:
        found, _, neighbours = queue_pairing(faces, kind.vertices)
        verify(torch.cat([wrong, found]))
    # Typed for meshes that share faces, but only these attributes are looked at.
    structure = AccelerationStructure.in_block(cast(Sizes, kind.sizes), device)
    bounds = torch.empty(12, dtype=torch.float32, device=device)
    values = torch.empty((1, *kind.shape), dtype=torch.float32, device=device)
    ambiguous = torch.zeros(2, dtype=torch.int32, device=device)
    slot = current_slot()
    address = None if slot is None else as_warp(slot.bind(values), wp.int64)
    with on_current_stream(vertices, vertices, faces, table, neighbours):
        tree = coarser(structure.view.tree, 0)
        set_array(tree, "parts", as_warp(parts, wp.int32))
        tree.meshes = 2
        view, empty = structure.view._replace(tree=tree), workspace(device)
        fill_surface(view, vertices[None], faces, neighbours, as_warp(bounds, wp.float32), join)
        target = Target(as_warp(values.view(-1), wp.float32), as_warp(ambiguous, wp.int32), address)
        slab = _slab(kind, as_warp(rows, wp.float64))
        with kernels_beside(values) as join_winding:
            slab_winding(tree, view.winding, slab, target.values, empty, kind.plan.most_columns)
        surface = Surface(tree, view.frames, view.features, view.cones)
        out = output_of(target, empty)
        run_stages(surface, slab, out, kind.plan, empty, partial(kernels_beside, values), join_winding)
    return values, neighbours


def _slab(kind: CapacityClass, rows: wp.array) -> Any:
    """Both slabs, as kernels take them."""
    slab = Slab()
    slab.turned, slab.shape, slab.meshes = int(kind.turned), wp.vec3i(*kind.shape), 2
    set_array(slab, "rows", rows)
    return slab
