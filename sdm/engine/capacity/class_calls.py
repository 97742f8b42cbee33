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
from sdm.engine.capacity.classes import CapacityClass
from sdm.engine.capacity.open_boundary import TOLD, OpenBoundary
from sdm.engine.capacity.tables import TABLE, both_slabs, split_table, write_table
from sdm.kernels.bvh.rank_sort import BUCKETS
from sdm.kernels.bvh.tree import coarser
from sdm.kernels.dense.counters import NEXT_LIST, NEXT_REGION
from sdm.kernels.dense.plan import Decisions
from sdm.kernels.dense.query import OwnStages, Pending, Surface, Target, output_of, run_stages
from sdm.kernels.dense.stage1_witnesses import find_witnesses
from sdm.kernels.dense.stage6_measure import measure_blocks
from sdm.kernels.dense.voxel_search import mend_slab
from sdm.kernels.dense.workspace import ZEROS as COUNTERS
from sdm.kernels.dense.workspace import make_workspace
from sdm.kernels.launch import new_zeros, set_array
from sdm.kernels.topology.edge_pairing import FLAGS, OUT_OF_RANGE
from sdm.kernels.topology.edge_table import table_length
from sdm.kernels.topology.filler_faces import VALUES_AT, copy_table, take_in, tell, tell_ambiguous
from sdm.kernels.winding.column_sums import begin_crossings, slab_winding
from sdm.runtime.graphs import TableCall, TableWork, Verify
from sdm.runtime.graphs.branches import MOMENTS, WINDING, Join, beside, fork, kernels_beside, nothing
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace
from sdm.topology.face_pairing import queue_pairing

# See `TableCall`.
Instead: TypeAlias = Callable[[], "TableCall[ClassMap] | None"]
Key: TypeAlias = tuple[str, CapacityClass, int]
# Zeros that kernels of a map need: those of a sort, and a few.
ZEROS = BUCKETS + 64
# Numbers of a table of edges that are zeroed with all else.
MOST_PLACES = 1 << 19
# The branch of what is told of a mesh's faces: nothing of a closed mesh's map waits for it.
TELLING = 1
# Bytes of maps that gain little by a recording, which keeps as much memory again: of a single one none is made.
LARGE = 1 << 27
# Results that a recording may have for the next calls, bytes of them, and most faces of meshes in question: of others a
# map takes longer than to ask for its memory.
MOST_SPARE, SPARE, MOST_SPARE_FACES = 4, 1 << 22, 20480


class Told(NamedTuple):
    """Topology of a mesh as a recording of a class tells it: its parts are looked at when somebody asks.

    Args:
        memory: All of it, int32 in a row.
        faces: Of the mesh.
        room: Of an open class, for edges; 0 of a closed one.
    """

    memory: Tensor
    faces: int
    room: int

    @property
    def neighbours(self) -> Tensor:
        """(F,4) int32, those of the mesh's faces."""
        return self.memory[: 4 * self.faces].view(self.faces, 4)

    @property
    def unmatched(self) -> Tensor:
        """(room,3) int32, of an open class: its unmatched edges come first."""
        return self.memory[4 * self.faces :][: 3 * self.room].view(self.room, 3)

    @property
    def boundary(self) -> Tensor:
        """Of an open class, the memory of an `OpenBoundary`."""
        return self.memory[4 * self.faces + 3 * self.room : self.last]

    @property
    def ambiguous(self) -> Tensor:
        """(1,) int32, of an open class: voxels that are."""
        return self.memory[self.last :][:1]

    @property
    def last(self) -> int:
        """Place of that number."""
        return 4 * self.faces + told_behind(self.room) - 1


class ClassMap(NamedTuple):
    """Results of a recording of a class."""

    values: Tensor  # (nx,ny,nz), the map
    told: Told


def class_key(kind: CapacityClass, room: int = 0) -> Key:
    """The key of the calls of a class about closed meshes, or about open ones with room for so many edges."""
    return "open class" if room else "class", kind, room


# A mesh as recordings read it by address: vertices (V,3) float32 and faces (F,3) int32, contiguous; the grid of its
# map; V, F and the device. A plain tuple, as each function on the way to a launch takes some microseconds.
Given: TypeAlias = tuple[Tensor, Tensor, Grid, int, int, torch.device]
# Memory for a map (nx,ny,nz), and for what is told of a mesh unless that is made for it, and where both are: tensors
# that were made for a call before are not looked at until this one's kernels are launched.
New: TypeAlias = tuple[Tensor, Tensor | None, int, int]


def class_call(
    kind: CapacityClass,
    decisions: Decisions,
    given: Given,
    room: int = 0,
    instead: Instead | None = None,
    make: Callable[[Tensor, Told], Any] = ClassMap,
) -> TableCall[Any]:
    """The call that makes the map of a mesh, if it is closed, or with `room` open by up to as many edges.

    The flags are of a vertex out of range, and the number of unmatched edges. With room for unmatched and for
    boundary edges they are those of `boundary_loops.join_edges`, and behind them the numbers of both. `instead`: of a
    `TableCall`. `make` makes the result of values and what is told, while the device is at work.
    """
    vertices, faces, _, _, total, device = given
    behind = told_behind(room)

    def fill(table: Any, new: New) -> tuple[Tensor, Tensor]:
        return fill_table(table, new, kind, decisions, given, behind)

    def launched(filled: tuple[Tensor, Tensor]) -> Any:
        values, told = filled
        return make(values, Told(told, total, room))

    return TableCall(_work_of(kind, device, room), fill, (vertices, faces), instead, launched)


def fill_table(
    table: Any, new: New, kind: CapacityClass, decisions: Decisions, given: Given, behind: int
) -> tuple[Tensor, Tensor]:
    """Fill the table of a recording of a class for a mesh, and give the map and what will be told.

    `behind`: see `told_behind`.
    """
    values, told, values_at, at = new
    vertices, faces, grid, count, total, _ = given
    numbers = 4 * total + behind
    if told is None:
        told = faces.new_empty(numbers)
        at = told.data_ptr()
    # The last number is that of the ambiguous voxels, which a closed mesh has not.
    addresses = vertices.data_ptr(), faces.data_ptr(), values_at, at + 4 * (numbers - 1), at
    write_table(table, kind, decisions, total, count, grid, addresses)
    return values, told


def told_behind(room: int) -> int:
    """Numbers that are told behind those of faces."""
    return 3 * room + OpenBoundary.length(room) + 1 if room else 0


@lru_cache(maxsize=256)
def _work_of(kind: CapacityClass, device: torch.device, room: int) -> TableWork:
    """Work of the calls of a class, about closed meshes or open ones with room for so many edges."""
    work = partial(_queue_open_map, kind, room, device) if room else partial(_queue_closed_map, kind, device)
    key, nbytes, behind = class_key(kind, room), 4 * math.prod(kind.shape), told_behind(room)
    # What is told is remembered: of few faces it does no harm if there is room for more.
    told = 4 * kind.most + behind if kind.most <= MOST_SPARE_FACES else 0
    spare = min(MOST_SPARE, SPARE // (nbytes + 4 * told)) if told else 0
    new = partial(_new_results, kind.shape, told, device)
    return TableWork(key, work, device, TABLE, key[0], new, spare, int(nbytes > LARGE))


def _new_results(shape: tuple[int, int, int], told: int, device: torch.device) -> New:
    values = torch.empty(shape, dtype=torch.float32, device=device)
    if not told:
        return values, None, values.data_ptr(), 0
    numbers = torch.empty(told, dtype=torch.int32, device=device)
    return values, numbers, values.data_ptr(), numbers.data_ptr()


class _Mesh(NamedTuple):
    """A mesh in a recording's own memory, room for the bounds of both, the table's parts, and zeros for kernels."""

    vertices: Tensor  # (room,3) float32
    faces: Tensor  # (room,3) int32
    bounds: Tensor  # (12,) float32
    rows: Tensor
    addresses: Tensor
    counts: Tensor
    parts: Tensor
    own: Tensor  # and all behind it: int32 zeros, these as many as are asked for
    edges: Tensor  # for the table of edges; none if they are many
    pairing: Tensor  # where an index out of range is told
    counters: Tensor  # of the map's pass
    zeros: Tensor

    def queue_pairing(self, kind: CapacityClass, room: int) -> tuple[Tensor, Tensor, Tensor]:
        """`queue_pairing` of its faces; the map makes little more if they leave more edges than `room` unmatched."""
        table = self.edges if self.edges.shape[0] else None
        stopped = self.counters[NEXT_REGION:NEXT_LIST]
        options: Any = {"by_table": True, "zeros": self.pairing, "table": table, "most": room, "stopped": stopped}
        return queue_pairing(self.faces, kind.vertices, **options)


def _take_in(kind: CapacityClass, device: torch.device, host: Tensor, own: int) -> _Mesh:
    """Queue the copies of the table and of the mesh that it tells of, with (own,) int32 zeros."""
    # Places of the table of edges come first, as they are of 8 bytes; of many faces they are zeroed beside other work.
    places = table_length(kind.faces)
    places = places if places <= MOST_PLACES else 0
    lengths = [places, own, FLAGS + kind.vertices, COUNTERS, ZEROS]
    zeros = torch.empty(sum(lengths), dtype=torch.int32, device=device)
    edges, mine, pairing, counters, rest = zeros.split(lengths)
    table = torch.empty(host.shape, dtype=host.dtype, device=device)
    rows, addresses, counts, parts = split_table(table)
    vertices = torch.empty((kind.vertices, 3), dtype=torch.float32, device=device)
    faces = torch.empty((kind.faces, 3), dtype=torch.int32, device=device)
    bounds = torch.empty(12, dtype=torch.float32, device=device)
    with on_current_stream(table, table):
        none, box = as_warp(zeros, wp.int32), as_warp(bounds, wp.float32)
        copy_table(host.data_ptr(), as_warp(table.view(torch.int64), wp.int64), none, box)
        take_in(
            as_warp(addresses, wp.int64),
            as_warp(counts, wp.int32),
            as_warp(vertices, wp.vec3),
            as_warp(faces, wp.int32),
            as_warp(pairing[OUT_OF_RANGE:], wp.int32),
            box,
        )
    return _Mesh(vertices, faces, bounds, rows, addresses, counts, parts, mine, edges, pairing, counters, rest)


def _queue_closed_map(kind: CapacityClass, device: torch.device, verify: Verify, table: Tensor) -> None:
    mesh = _take_in(kind, device, table, 2)
    with beside(device) as join:
        found, _, neighbours = mesh.queue_pairing(kind, 0)
    told: list[Join] = []

    def tell_host() -> None:
        # On a branch that closed meshes leave alone, as neither zeros nor cones wait for it.
        with beside(device, MOMENTS, since=join) as joined:
            verify(found, 0, partial(_tell, mesh, neighbours, found[:0], found[:0], found))
        told.append(joined)

    _queue_map(kind, mesh, neighbours, join, mesh.own, None, built=tell_host)
    told[0]()


def _queue_open_map(kind: CapacityClass, room: int, device: torch.device, verify: Verify, table: Tensor) -> None:
    mesh = _take_in(kind, device, table, OpenBoundary.length(room))
    boundary = OpenBoundary.of_memory(mesh.own, room)
    with beside(device) as join:
        found, unmatched, neighbours = mesh.queue_pairing(kind, room)

    def begin_joining() -> tuple[Join, Join]:
        written: list[Join] = []
        with beside(device, TELLING, since=join) as joined:
            boundary.queue_joining(unmatched, found, mesh.vertices, lambda: written.append(fork(device)))
        return written[0], joined

    def count_ambiguous() -> None:
        tell_ambiguous(as_warp(mesh.addresses, wp.int64), as_warp(boundary.ambiguous, wp.int32))

    joined = _queue_map(kind, mesh, neighbours, join, boundary.ambiguous, boundary, begin_joining, count_ambiguous)
    with beside(device, TELLING, since=joined) as told:
        verify(
            boundary.numbers,
            TOLD,
            partial(_tell, mesh, neighbours, unmatched[:room], boundary.memory, boundary.numbers),
        )
    told()


def _tell(mesh: _Mesh, neighbours: Tensor, unmatched: Tensor, boundary: Tensor, flags: Tensor, host: int) -> None:
    with on_current_stream(neighbours):
        tell(
            as_warp(mesh.counts, wp.int32),
            as_warp(mesh.addresses, wp.int64),
            as_warp(neighbours.view(-1), wp.int32),
            as_warp(unmatched.view(-1), wp.int32),
            as_warp(boundary, wp.int32),
            as_warp(flags, wp.int32),
            host,
        )


def _queue_map(
    kind: CapacityClass,
    mesh: _Mesh,
    neighbours: Tensor,
    join: Join,
    ambiguous: Tensor,
    boundary: OpenBoundary | None,
    begin_joining: Callable[[], tuple[Join, Join]] = lambda: (nothing, nothing),
    measured: Callable[[], None] = lambda: None,
    built: Callable[[], None] = lambda: None,
) -> Join:
    """The map of a mesh, to the address in the table: its neighbours are there after `join`.

    Of what `begin_joining` gives, the first waits for its boundary edges, the second, which is given, for all of its
    boundary. What everything waits for is queued first. `built` queues what comes once all is built, `measured` once
    voxels are measured, beside the rest.
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
        view, empty = structure.view._replace(tree=tree), workspace(device, mesh.zeros)
        box: Any = as_warp(mesh.bounds, wp.float32)
        work, begin = make_workspace(kind.plan, empty, as_warp(mesh.counters, wp.int32)), fork(device)
        unjoined: list[Join] = []
        # Once triangles are in order: winding numbers do not wait for boxes.
        ordered: list[Join] = []
        options: Any = {"unjoined": unjoined, "features_later": True, "fillers": True, "is_bounded": True}
        options |= {"counts": new_zeros(empty, BUCKETS), "gathered": lambda: ordered.append(fork(device))}
        fill_surface(view, vertices[None], mesh.faces, neighbours, box, join, **options)
        boxes = fork(device)
        target = Target(as_warp(values, wp.float32), as_warp(ambiguous, wp.int32), address)
        slab, winding = both_slabs(kind, mesh.rows), view.winding
        if boundary is not None:
            winding = boundary.winding(view)
        # Nothing before it waits for these, and they for nothing.
        with kernels_beside(values, TELLING, since=begin) as begun:
            work.begin_pass(kind.plan, 0, is_zero=True)
        begun()
        built()
        # For these the winding numbers alone wait.
        with kernels_beside(values, TELLING, since=begin) as zeroed:
            crossings = begin_crossings(winding, slab, target.values, empty, alone=True)
            if crossings is None and (not kind.turned or (boundary is not None and boundary.by_faces)):
                target.values.zero_()

        def before_boundary() -> Join:
            # Triangles are marked in columns without boxes, but what follows asks the tree: the rays of a turned grid,
            # and voxels by themselves.
            boxes()
            if boundary is None:
                return nothing
            joins[0]()
            of_mesh = vertices, mesh.faces, mesh.counts
            return boundary.queue_winding(winding, view.tree, *of_mesh, box, empty, few, joins[1])

        def wind() -> None:
            joins.extend(begin_joining())
            with kernels_beside(values, WINDING, zeroed, ordered[0]) as wound:
                options: Any = {"is_zero": crossings is None, "crossings": crossings}
                columns = kind.plan.most_columns
                slab_winding(tree, winding, slab, target.values, empty, columns, before_boundary, **options)
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
            joins[2]()

        def measure(*inputs: Any) -> None:
            measure_blocks(*inputs)
            with beside_winding() as joined:
                measured()
            joins.append(joined)

        beside_winding = partial(kernels_beside, values, WINDING)
        own = OwnStages(find_witnesses, measure, mend_slab)
        run_stages(surface, slab, out, kind.plan, empty, beside_winding, join_winding, own, pending, work)
        joins[3]()
    return joins[1]
