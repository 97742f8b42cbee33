"""Maps by capacity class: a mesh is one of two that differ, and the faces behind its own are the other.

So the kernels for meshes that differ (`sdm.engine.ragged`) do all the work, and a map is bit for bit that of a call
for its counts. The second mesh has faces of no area and a grid without voxels. Closed meshes have calls of their own,
which know nothing of boundaries.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple, TypeAlias, cast

import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.acceleration import AccelerationStructure, Sizes, fill_surface
from sdm.engine.capacity.classes import MOST_EDGES, CapacityClass
from sdm.engine.capacity.open_boundary import TOLD, OpenBoundary
from sdm.engine.capacity.tables import TABLE, both_slabs, split_table, write_table
from sdm.kernels.bvh.tree import coarser
from sdm.kernels.dense.plan import Decisions
from sdm.kernels.dense.query import Pending, Surface, Target, output_of, run_stages
from sdm.kernels.dense.workspace import make_workspace
from sdm.kernels.launch import set_array
from sdm.kernels.topology.filler_faces import VALUES_AT, copy_table, take_in, tell, tell_ambiguous
from sdm.kernels.winding.column_sums import slab_winding
from sdm.runtime.graphs import TableCall, Verify
from sdm.runtime.graphs.branches import WINDING, Join, beside, fork, kernels_beside, nothing
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace
from sdm.topology.face_pairing import queue_pairing

# See `TableCall`.
Instead: TypeAlias = Callable[[], "TableCall[ClassMap] | None"]
Key: TypeAlias = tuple[str, CapacityClass, int]
# The branch of what is told of a mesh's faces: nothing of a closed mesh's map waits for it.
TELLING = 1
# Bytes of maps that gain little by a recording, which keeps as much memory again: of a single one none is made.
LARGE = 1 << 27


class ClassMap(NamedTuple):
    """Results of a recording of a class.

    Args:
        values: (nx,ny,nz), the map.
        neighbours: (F,4) int32, those of the mesh's faces.
        ambiguous: (1,) int32, of an open class: voxels that are.
        unmatched: (room,3) int32, of an open class: its unmatched edges come first.
        boundary: Of an open class, the memory of an `OpenBoundary`.
    """

    values: Tensor
    neighbours: Tensor
    ambiguous: Tensor | None = None
    unmatched: Tensor | None = None
    boundary: Tensor | None = None


def class_key(kind: CapacityClass, room: int = 0) -> Key:
    """The key of the calls of a class about closed meshes, or about open ones with room for so many edges."""
    return "open class" if room else "class", kind, room


def class_call(
    kind: CapacityClass,
    decisions: Decisions,
    vertices: Tensor,
    faces: Tensor,
    grid: Grid,
    instead: Instead | None = None,
) -> TableCall[ClassMap]:
    """The call that makes the map of a mesh, if it is closed: `vertices` (V,3) and `faces` (F,3) are contiguous.

    The flags are of a vertex out of range, twice, and the number of unmatched edges. `instead`: of a `TableCall`.
    """
    device, count = faces.device, faces.shape[0]

    def fill(table: Any) -> ClassMap:
        # Of the inputs' types and device: fewer words for torch to read.
        values, neighbours = vertices.new_empty(kind.shape), faces.new_empty((count, 4))
        at = vertices.data_ptr(), faces.data_ptr(), values.data_ptr(), 0, neighbours.data_ptr()
        write_table(table, kind, decisions, count, vertices.shape[0], grid, at)
        return ClassMap(values, neighbours)

    key, work, later = _of_class(kind, device, 0)
    return TableCall(key, work, device, TABLE, fill, (vertices, faces), key[0], later, instead)


def open_class_call(
    kind: CapacityClass,
    decisions: Decisions,
    vertices: Tensor,
    faces: Tensor,
    grid: Grid,
    instead: Instead | None = None,
    room: int = MOST_EDGES,
) -> TableCall[ClassMap]:
    """The same of a mesh that is open by up to `room` unmatched and boundary edges, or by none.

    The flags are those of `boundary_loops.join_edges`, and behind them the numbers of unmatched and of boundary edges.
    """
    device, count = faces.device, faces.shape[0]
    lengths = [4 * count, 3 * room, OpenBoundary.length(room), 1]

    def fill(table: Any) -> tuple[Tensor, Tensor]:
        values, told = vertices.new_empty(kind.shape), faces.new_empty(sum(lengths))
        at = told.data_ptr()
        places = vertices.data_ptr(), faces.data_ptr(), values.data_ptr(), at + 4 * sum(lengths[:-1]), at
        write_table(table, kind, decisions, count, vertices.shape[0], grid, places)
        return values, told

    def launched(filled: tuple[Tensor, Tensor]) -> ClassMap:
        values, told = filled
        neighbours, unmatched, boundary, ambiguous = told.split(lengths)
        return ClassMap(values, neighbours.view(count, 4), ambiguous, unmatched.view(room, 3), boundary)

    key, work, later = _of_class(kind, device, room)
    return TableCall(key, work, device, TABLE, fill, (vertices, faces), key[0], later, instead, launched)


@lru_cache(maxsize=256)
def _of_class(kind: CapacityClass, device: torch.device, room: int) -> tuple[Key, Callable[..., None], int]:
    """Key and work of a class's call, and by how many calls its recording is made later."""
    work = partial(_queue_open_map, kind, room, device) if room else partial(_queue_closed_map, kind, device)
    return class_key(kind, room), work, int(4 * math.prod(kind.shape) > LARGE)


class _Mesh(NamedTuple):
    """A mesh in a recording's own memory, room for the bounds of both, and the table's parts."""

    vertices: Tensor  # (room,3) float32
    faces: Tensor  # (room,3) int32
    bounds: Tensor  # (12,) float32
    rows: Tensor
    addresses: Tensor
    counts: Tensor
    parts: Tensor


def _take_in(kind: CapacityClass, device: torch.device, host: Tensor, zeros: Tensor) -> _Mesh:
    """Queue the copies of the table and of the mesh that it tells of; the first of `zeros` is set if an index is wrong.

    They are zero before, as is the rest of them.
    """
    table = torch.empty(host.shape, dtype=host.dtype, device=device)
    rows, addresses, counts, parts = split_table(table)
    vertices = torch.empty((kind.vertices, 3), dtype=torch.float32, device=device)
    faces = torch.empty((kind.faces, 3), dtype=torch.int32, device=device)
    bounds = torch.empty(12, dtype=torch.float32, device=device)
    with on_current_stream(table, table):
        wrong = as_warp(zeros, wp.int32)
        copy_table(host.data_ptr(), as_warp(table.view(torch.int64), wp.int64), wrong, as_warp(bounds, wp.float32))
        take_in(
            as_warp(addresses, wp.int64),
            as_warp(counts, wp.int32),
            as_warp(vertices, wp.vec3),
            as_warp(faces, wp.int32),
            wrong,
        )
    return _Mesh(vertices, faces, bounds, rows, addresses, counts, parts)


def _queue_closed_map(kind: CapacityClass, device: torch.device, verify: Verify, table: Tensor) -> None:
    zeros = torch.empty(3, dtype=torch.int32, device=device)
    wrong, ambiguous = zeros.split([1, 2])
    mesh = _take_in(kind, device, table, zeros)
    with beside(device) as join:
        found, _, neighbours = queue_pairing(mesh.faces, kind.vertices, by_table=True)
    _queue_map(kind, mesh, neighbours, join, ambiguous, None)
    with beside(device, TELLING, since=join) as told:
        verify(torch.cat([wrong, found]))
        none = found[:0]
        _tell(mesh, neighbours, none, none)
    told()


def _queue_open_map(kind: CapacityClass, room: int, device: torch.device, verify: Verify, table: Tensor) -> None:
    boundary = OpenBoundary.empty(device, room)
    # The first flag is that of a vertex out of range.
    mesh = _take_in(kind, device, table, boundary.memory)
    with beside(device) as join:
        found, unmatched, neighbours = queue_pairing(mesh.faces, kind.vertices, by_table=True)

    def begin_joining() -> Join:
        with beside(device, TELLING, since=join) as joined:
            boundary.queue_joining(unmatched, found, mesh.vertices)
        return joined

    joined = _queue_map(kind, mesh, neighbours, join, boundary.ambiguous, boundary, begin_joining)
    with beside(device, TELLING, since=joined) as told:
        verify(boundary.numbers, TOLD)
        _tell(mesh, neighbours, unmatched[:room], boundary.memory)
    told()
    with on_current_stream(mesh.addresses):
        tell_ambiguous(as_warp(mesh.addresses, wp.int64), as_warp(boundary.ambiguous, wp.int32))


def _tell(mesh: _Mesh, neighbours: Tensor, unmatched: Tensor, boundary: Tensor) -> None:
    told = (mesh.counts, neighbours.view(-1), unmatched.view(-1), boundary)
    counts, *numbers = (as_warp(tensor, wp.int32) for tensor in told)
    with on_current_stream(neighbours):
        tell(counts, as_warp(mesh.addresses, wp.int64), *numbers)


def _queue_map(
    kind: CapacityClass,
    mesh: _Mesh,
    neighbours: Tensor,
    join: Join,
    ambiguous: Tensor,
    boundary: OpenBoundary | None,
    begin_joining: Callable[[], Join] = lambda: nothing,
) -> Join:
    """The map of a mesh, to the address in the table: its neighbours are there after `join`.

    Gives what `begin_joining` gave, after which its boundary is there. What everything waits for is queued first.
    """
    vertices, device = mesh.vertices, mesh.vertices.device
    # Typed for meshes that share faces, but only these attributes are looked at.
    sizes = kind.sizes if boundary is None else kind.open_sizes(boundary.room)
    structure = AccelerationStructure.in_block(cast(Sizes, sizes), device)
    # Of winding numbers: the distances go elsewhere.
    values = torch.empty((1, *kind.shape), dtype=torch.float32, device=device)
    address = as_warp(mesh.addresses[VALUES_AT : VALUES_AT + 1], wp.int64)
    joins: list[Join] = []
    few = boundary is None or boundary.room <= kind.few_edges(device.type)
    with on_current_stream(vertices, vertices, mesh.faces, mesh.rows, neighbours):
        tree = coarser(structure.view.tree, 0)
        set_array(tree, "parts", as_warp(mesh.parts, wp.int32))
        tree.meshes = 2
        view, empty = structure.view._replace(tree=tree), workspace(device)
        box: Any = as_warp(mesh.bounds, wp.float32)
        # Counters are zero by then.
        work = make_workspace(kind.plan, empty)
        with kernels_beside(values, TELLING) as begun:
            work.begin_pass(kind.plan, 0)
        unjoined: list[Join] = []
        options: Any = {"unjoined": unjoined, "features_later": True, "fillers": True, "is_reset": True}
        fill_surface(view, vertices[None], mesh.faces, neighbours, box, join, **options)
        begun()
        built = fork(device)
        target = Target(as_warp(values, wp.float32), as_warp(ambiguous, wp.int32), address)
        slab, winding = both_slabs(kind, mesh.rows), view.winding
        if boundary is not None:
            winding = boundary.winding(view)

        def before_boundary() -> Join:
            if boundary is None:
                return nothing
            joins[0]()
            return boundary.queue_winding(winding, view.tree, vertices, box, empty, few)

        def wind() -> None:
            joins.append(begin_joining())
            with kernels_beside(values, WINDING, since=built) as wound:
                slab_winding(tree, winding, slab, target.values, empty, kind.plan.most_columns, before_boundary)
            joins.append(wound)

        def before_regions() -> None:
            # Of an open mesh all that follows may have to wait for its winding numbers.
            if not few:
                wind()
            unjoined[0]()

        def before_blocks() -> None:
            if few:
                wind()
            unjoined[1]()

        surface = Surface(tree, view.frames, view.features, view.cones)
        out = output_of(target, empty)
        pending = Pending(cones=before_regions, features=before_blocks)

        def join_winding() -> None:
            joins[1]()

        beside_winding = partial(kernels_beside, values, WINDING)
        run_stages(surface, slab, out, kind.plan, empty, beside_winding, join_winding, pending=pending, begun=work)
    return joins[0]
