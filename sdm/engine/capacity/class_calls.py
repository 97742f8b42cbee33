"""Maps by capacity class: a mesh is one of two that differ, and the faces behind its own are the other.

So the kernels for meshes that differ (`sdm.engine.ragged`) do all the work, and a map is bit for bit that of a call
for its counts. The second mesh has faces of no area and a grid without voxels. Closed meshes have calls of their own,
which know nothing of boundaries.
"""

from __future__ import annotations

from functools import partial
from typing import Any, cast

import torch
import warp as wp
from torch import Tensor

from sdm.engine.acceleration import AccelerationStructure, Sizes, fill_surface
from sdm.engine.capacity.classes import MOST_EDGES, CapacityClass
from sdm.engine.capacity.open_boundary import TOLD, OpenBoundary
from sdm.engine.capacity.tables import both_slabs, split_table
from sdm.kernels.bvh.tree import coarser
from sdm.kernels.dense.query import Surface, Target, output_of, run_stages
from sdm.kernels.launch import set_array
from sdm.kernels.topology.filler_faces import fill_up
from sdm.kernels.winding.column_sums import slab_winding
from sdm.runtime.graphs import Call, Verify
from sdm.runtime.graphs.branches import Join, beside, kernels_beside
from sdm.runtime.graphs.output_slot import current_slot
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace
from sdm.topology.face_pairing import queue_pairing

Inputs = tuple[Tensor, Tensor, Tensor]


def class_key(kind: CapacityClass, is_open: bool = False) -> tuple[str, CapacityClass]:
    """The key of the calls of a class about closed meshes, or about open ones."""
    return "open class" if is_open else "class", kind


def class_call(kind: CapacityClass, inputs: Inputs) -> Call:
    """The call that makes the map (1,nx,ny,nz) of a mesh, if it is closed, and the faces' neighbours (F,4).

    `class_inputs` makes its inputs, and `to_record` those of a recording. The flags are of a vertex out of range,
    twice, and the number of unmatched edges.
    """
    return Call(class_key(kind), partial(_queue_closed_map, kind), inputs)


def open_class_call(kind: CapacityClass, inputs: Inputs) -> Call:
    """The same of a mesh that is open by up to MOST_EDGES unmatched and boundary edges, or by none.

    Gives the map, the memory of an `OpenBoundary`, the neighbours and the unmatched edges (MOST_EDGES,3). The flags are
    those of `boundary_loops.join_edges`, and behind them the numbers of unmatched and of boundary edges.
    """
    return Call(class_key(kind, is_open=True), partial(_queue_open_map, kind), inputs)


def _queue_closed_map(
    kind: CapacityClass, verify: Verify, vertices: Tensor, given: Tensor, table: Tensor
) -> tuple[Tensor, Tensor]:
    device = vertices.device
    faces, wrong = torch.empty_like(given), torch.zeros(1, dtype=torch.int32, device=device)
    _fill_up(table, given, faces, wrong)
    with beside(device) as join:
        found, _, neighbours = queue_pairing(faces, kind.vertices)
        verify(torch.cat([wrong, found]))
    ambiguous = torch.zeros(2, dtype=torch.int32, device=device)
    return _queue_map(kind, vertices, faces, table, neighbours, join, ambiguous, None), neighbours


def _queue_open_map(
    kind: CapacityClass, verify: Verify, vertices: Tensor, given: Tensor, table: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    device = vertices.device
    faces, boundary = torch.empty_like(given), OpenBoundary.empty(device)
    # The first flag is that of a vertex out of range.
    _fill_up(table, given, faces, boundary.numbers[:1])
    with beside(device) as join:
        found, unmatched, neighbours = queue_pairing(faces, kind.vertices)
        boundary.queue_joining(unmatched, found, vertices)
        verify(boundary.numbers, TOLD)
    values = _queue_map(kind, vertices, faces, table, neighbours, join, boundary.ambiguous, boundary)
    return values, boundary.memory, neighbours, unmatched[:MOST_EDGES]


def _fill_up(table: Tensor, given: Tensor, faces: Tensor, wrong: Tensor) -> None:
    _, counts, _ = split_table(table)
    with on_current_stream(given, given, table):
        fill_up(*(as_warp(tensor, wp.int32) for tensor in (counts, given, faces, wrong)))


def _queue_map(
    kind: CapacityClass,
    vertices: Tensor,
    faces: Tensor,
    table: Tensor,
    neighbours: Tensor,
    join: Join,
    ambiguous: Tensor,
    boundary: OpenBoundary | None,
) -> Tensor:
    """The map of a mesh, whose boundary was joined before `join`, or which has none."""
    device = vertices.device
    rows, _, parts = split_table(table)
    # Typed for meshes that share faces, but only these attributes are looked at.
    sizes = kind.sizes if boundary is None else kind.open_sizes
    structure = AccelerationStructure.in_block(cast(Sizes, sizes), device)
    bounds = torch.empty(12, dtype=torch.float32, device=device)
    values = torch.empty((1, *kind.shape), dtype=torch.float32, device=device)
    slot = current_slot()
    address = None if slot is None else as_warp(slot.bind(values), wp.int64)
    with on_current_stream(vertices, vertices, faces, table, neighbours):
        tree = coarser(structure.view.tree, 0)
        set_array(tree, "parts", as_warp(parts, wp.int32))
        tree.meshes = 2
        view, empty = structure.view._replace(tree=tree), workspace(device)
        box: Any = as_warp(bounds, wp.float32)
        fill_surface(view, vertices[None], faces, neighbours, box, join)
        target = Target(as_warp(values, wp.float32), as_warp(ambiguous, wp.int32), address)
        slab = both_slabs(kind, rows)
        with kernels_beside(values) as join_winding:
            winding = view.winding if boundary is None else boundary.queue_caps(view, vertices, box, empty)
            slab_winding(tree, winding, slab, target.values, empty, kind.plan.most_columns)
        surface = Surface(tree, view.frames, view.features, view.cones)
        out = output_of(target, empty)
        run_stages(surface, slab, out, kind.plan, empty, partial(kernels_beside, values), join_winding)
    return values
