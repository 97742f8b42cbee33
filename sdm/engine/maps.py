"""Whole maps, from vertices and faces to values: queued step by step, or all at once from a CUDA graph.

Each call without gradients on a GPU is a function of a few tensors that queues kernels and does nothing else, so that
`sdm.runtime.graphs` can record it. What a mesh's faces say by themselves is looked up beforehand, with one exception:
as soon as such calls are recorded, faces never seen before are taken for those of a closed mesh, or of an open one with
room for its edges (`sdm.engine.capacity`); where there are no such classes, of one with as many boundary edges as the
last open one of as many vertices and faces. What they say is read while the map is under way; if the guess was wrong,
the map is thrown away and made anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TypeVar

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.acceleration import (
    AccelerationStructure,
    Sizes,
    build,
    closed_by_faces,
    kind_of,
    topology_for,
)
from sdm.engine.capacity.classes import class_of
from sdm.engine.capacity.first_maps import class_map, has_room
from sdm.engine.capacity.ready_maps import Tried, looks_closed
from sdm.engine.first_build import build_first
from sdm.engine.ops import map_slab, structure_slab
from sdm.engine.plan_override import OPTIONS
from sdm.engine.structure.build_beside import build_beside
from sdm.errors import GridError
from sdm.kernels.dense.cost_model import THINNEST_SLAB
from sdm.kernels.dense.plan import memory_of
from sdm.runtime import graphs
from sdm.runtime.graphs import Call, Verify
from sdm.runtime.graphs.branches import Join, beside
from sdm.runtime.host_copy import number_later
from sdm.runtime.operators import is_eager
from sdm.runtime.torch_warp import warp_name
from sdm.topology import guesses
from sdm.topology.boundary_edges import MeshTopology
from sdm.topology.cap_triangles import turned
from sdm.topology.face_pairing import Pairing, is_known, pairing_of, queue_pairing, remember_closed
from sdm.topology.same_boundary import can_be_told, note_ends, queue_comparison

# What is made of a map.
T = TypeVar("T")
# A launch's indices are 32 bits wide.
LARGEST_SLAB = 1 << 30
# Whether meshes never seen before are replayed by capacity class.
USE_CLASSES = True
# Larger results are not worth a recording: their kernels take longer than it takes to launch them.
LARGEST_RECORDED = 1 << 29


def slabs_of(grid: Grid, voxels: int, first: int = 0, last: int | None = None) -> Iterator[tuple[int, int]]:
    """Layers (begin, end) of slabs with about as many voxels, from layer `first` to before `last`.

    Raises:
        GridError: The thinnest slab has more voxels than a launch can count.
    """
    if _thinnest(grid) > LARGEST_SLAB:
        raise GridError(
            f"{THINNEST_SLAB} layers of a grid of shape {grid.shape} have more than {LARGEST_SLAB:,} voxels: "
            "split it along y or z, or let x be its longest axis"
        )
    layers = max(THINNEST_SLAB, voxels // (grid.shape[1] * grid.shape[2]) // THINNEST_SLAB * THINNEST_SLAB)
    last = grid.shape[0] if last is None else last
    for begin in range(first, last, layers):
        yield begin, min(begin + layers, last)


def _thinnest(grid: Grid) -> int:
    """Voxels of the smallest slab that there can be."""
    return min(THINNEST_SLAB, grid.shape[0]) * grid.shape[1] * grid.shape[2]


def put_together(slabs: Iterable[tuple[int, int, Tensor]], layers: int) -> Tensor:
    """The maps (B,layers,ny,nz) of slabs (begin, end, values); of those never more than one at a time is there."""
    whole = None
    for begin, end, values in slabs:
        if end - begin == layers:
            return values
        if whole is None:
            whole = values.new_empty((values.shape[0], layers, *values.shape[2:]))
        whole[:, begin:end] = values
    if whole is None:
        raise ValueError("a map without slabs")
    return whole


def moves_without_wait(vertices: Tensor) -> bool:
    """True if the structure of moved vertices may be built later, by what needs it."""
    return vertices.is_cuda and not vertices.requires_grad and is_eager(vertices)


def is_recordable(vertices: Tensor, nbytes: int) -> bool:
    """True if a call of so many bytes about meshes with these vertices may be recorded and replayed."""
    return vertices.is_cuda and nbytes <= LARGEST_RECORDED and graphs.supports(vertices)


def mesh_map(
    vertices: Tensor, faces: Tensor, grid: Grid, make: Callable[[Tensor], T], tried: Tried | None = None
) -> tuple[T, Callable[[], int] | None]:
    """The map (nx,ny,nz) of a recordable mesh as `make` makes it, while the device is at work if it is a first map.

    And a counter of its ambiguous voxels, None for a closed mesh. `tried`: see `ready_map`.
    """
    vertices, count = vertices.detach() if vertices.requires_grad else vertices, vertices.shape[0]
    if is_known(faces, count):
        return _made(make, _known_maps(vertices[None], faces, grid))
    last, kind = guesses.last_numbers(faces, count), None
    # Also of one that has as many as a mesh without room had, but looks closed.
    fits = last is guesses.CLOSED or (last is not None and has_room(last))
    if USE_CLASSES and (fits or looks_closed(faces.shape[0], count)):
        kind = class_of(faces.shape[0], count, grid, memory_of(warp_name(faces.device)))
    if kind is not None:
        replayed = class_map(*kind, vertices, faces, grid, make, tried)
        if replayed is not None:
            return replayed
    guessed = guesses.guess(faces, count)

    def settle() -> tuple[tuple[Tensor, ...], Call | None]:
        if kind is None and guesses.is_hopeless(faces, count):
            topology = topology_for(vertices, faces)
            guesses.remember(faces, count, topology.boundary)
            return graphs.run(_known_call(vertices[None], faces, grid, topology.boundary)), None
        structure, topology = build_first(vertices, faces)
        found = structure_slab(structure, grid, 0, grid.shape[0])
        found = found if topology.boundary.shape[0] else found[:1]
        better, now = guesses.guess(faces, count), guesses.last_numbers(faces, count)
        if kind is not None and now is not None and has_room(now):
            # All its meshes, of whatever counts, share a recording, which was not made yet.
            return found, None
        if guesses.is_right(better, faces, count):
            return found, _guessed_call(better, vertices, faces, grid)
        return found, _known_call(vertices[None], faces, grid, topology.boundary)

    found, was_guessed = graphs.speculate(_guessed_call(guessed, vertices, faces, grid), settle)
    if was_guessed and guessed == guesses.CLOSED:
        remember_closed(faces, count, found[1])
        return make(found[0][0]), None
    return _made(make, found)


def index_map(structure: AccelerationStructure, grid: Grid) -> tuple[Tensor, Tensor]:
    """The map (nx,ny,nz) of a recordable mesh whose structure is built, and how many voxels are ambiguous (1,)."""
    key = "index", structure.sizes, grid, OPTIONS.get()
    values, ambiguous = graphs.run(Call(key, partial(_queue_index_map, structure.sizes, grid), structure.memory))
    return values[0], ambiguous


def unsigned_index_map(structure: AccelerationStructure, grid: Grid) -> Tensor:
    """`index_map` without a sign."""
    key = "unsigned index", structure.sizes, grid, OPTIONS.get()
    work = partial(_queue_index_map, structure.sizes, grid, signed=False)
    return graphs.run(Call(key, work, structure.memory))[0][0]


def unsigned_mesh_map(vertices: Tensor, faces: Tensor, grid: Grid) -> Tensor:
    """`mesh_map` without a sign, for which nobody needs to know a boundary."""
    key = "unsigned", vertices.shape[0], faces.shape[0], grid, OPTIONS.get()
    return graphs.run(Call(key, partial(_queue_unsigned_map, grid), (vertices.detach(), faces)))[0][0]


def batch_maps(vertices: Tensor, faces: Tensor, grid: Grid, edges: Tensor | None) -> Tensor:
    """`sdm.signed_distance_maps` of tensors that are known to fit; with the boundary `edges` (E,2) it never waits."""
    meshes, voxels = vertices.shape[0], math.prod(grid.shape)
    if is_recordable(vertices, 4 * meshes * voxels):
        vertices, faces = vertices.detach().contiguous(), faces.contiguous()
        if edges is None:
            return _known_maps(vertices, faces, grid)[0]
        return graphs.run(_known_call(vertices, faces, grid, edges))[0]
    # A map's stride is 32 bits wide, too: two maps share a slab of less than 4 GiB.
    if meshes * voxels < LARGEST_SLAB:
        structure = build(vertices.detach(), faces, edges, for_maps=True)
        return map_slab(vertices, faces, structure, grid, 0, grid.shape[0])[0]
    most = max(1, LARGEST_SLAB // _thinnest(grid))
    if meshes > most:
        return torch.cat([batch_maps(some, faces, grid, edges) for some in vertices.split(most)])
    structure = build(vertices.detach(), faces, edges, for_maps=True)
    slabs = slabs_of(grid, (LARGEST_SLAB - 1) // meshes)
    return put_together(
        ((begin, end, map_slab(vertices, faces, structure, grid, begin, end)[0]) for begin, end in slabs),
        grid.shape[0],
    )


def _known_maps(vertices: Tensor, faces: Tensor, grid: Grid) -> tuple[Tensor, ...]:
    """The maps (B,nx,ny,nz) of meshes whose faces were paired, and of open ones the ambiguous voxels (B,).

    Of open meshes that were here before, the device looks whether they still have the same boundary: the host would
    have to wait for the vertices.
    """
    pairing = pairing_of(faces, vertices.shape[1])
    if not can_be_told(pairing, vertices.shape[0]):
        return graphs.run(_known_call(vertices, faces, grid, None))
    if pairing.edges is not None and pairing.same is not None:
        again = _unmoved_call(vertices, faces, grid, pairing, pairing.edges)
        found, _ = graphs.attempt(again)
        if found is not None:
            return found
        if graphs.is_recorded(faces.device, again.key):
            return graphs.run(_known_call(vertices, faces, grid, None))
    call = _known_call(vertices, faces, grid, None)
    found = call.work(graphs.unverified, *call.inputs)
    if pairing.edges is not None:
        note_ends(pairing, vertices)
        graphs.note(_unmoved_call(vertices, faces, grid, pairing, pairing.edges))
    return found


def _unmoved_call(vertices: Tensor, faces: Tensor, grid: Grid, pairing: Pairing, edges: Tensor) -> Call:
    """`_known_call` of a mesh with these boundary edges, if it still has them."""
    call = _known_call(vertices, faces, grid, edges)
    key = "unmoved", pairing.unmatched.shape[0], call.key
    ends = () if pairing.same is None else (pairing.unmatched, pairing.same)
    return Call(key, partial(_queue_unmoved_maps, grid), (*call.inputs, *ends))


def _made(make: Callable[[Tensor], T], found: tuple[Tensor, ...]) -> tuple[T, Callable[[], int] | None]:
    return make(found[0][0]), number_later(found[1]) if len(found) > 1 else None


def _known_call(vertices: Tensor, faces: Tensor, grid: Grid, edges: Tensor | None) -> Call:
    """The call that makes maps (B,nx,ny,nz) of faces seen before, and of open meshes counts ambiguous voxels (B,)."""
    topology = topology_for(vertices, faces, edges)
    key = "known", vertices.shape, faces.shape[0], topology.boundary.shape[0], grid, OPTIONS.get()
    return Call(key, partial(_queue_maps, grid), (vertices, faces, *topology))


def _guessed_call(guessed: guesses.Guess, vertices: Tensor, faces: Tensor, grid: Grid) -> Call:
    """The call that makes a map if the guess about its faces is right."""
    key = "guessed", vertices.shape[0], faces.shape[0], guessed, grid, OPTIONS.get()
    return Call(key, partial(_queue_guessed_map, guessed, grid), (vertices, faces))


def _queue_maps(
    grid: Grid,
    verify: Verify,
    vertices: Tensor,
    faces: Tensor,
    neighbours: Tensor,
    boundary: Tensor,
    caps: Tensor,
    *,
    join: Join | None = None,
) -> tuple[Tensor, ...]:
    structure, pending = build_beside(vertices, faces, MeshTopology(neighbours, boundary, caps), join)
    found = structure_slab(structure, grid, 0, grid.shape[0], pending=pending)
    return found if boundary.shape[0] else found[:1]


def _queue_unmoved_maps(
    grid: Grid,
    verify: Verify,
    vertices: Tensor,
    faces: Tensor,
    neighbours: Tensor,
    boundary: Tensor,
    caps: Tensor,
    unmatched: Tensor,
    same: Tensor,
) -> tuple[Tensor, ...]:
    with beside(faces.device) as join:
        verify(queue_comparison(unmatched, same, vertices))
    return _queue_maps(grid, verify, vertices, faces, neighbours, boundary, caps, join=join)


def _queue_guessed_map(
    guessed: guesses.Guess, grid: Grid, verify: Verify, vertices: Tensor, faces: Tensor
) -> tuple[Tensor, Tensor]:
    """The map (1,nx,ny,nz); of a closed mesh its neighbours (F,4), of an open one its ambiguous voxels (1,)."""
    with beside(faces.device) as join:
        topology = guesses.queue_guessed(guessed, vertices, faces, verify)
    # The kernels after this trust the faces, which only later turn out to be out of range.
    within = faces.clamp(0, vertices.shape[0] - 1)
    edges, count = topology.boundary.shape[0], faces.shape[0]
    if closed_by_faces(kind_of(edges, count), edges, count):
        topology = topology._replace(caps=turned(within))
    found = _queue_maps(grid, verify, vertices[None], within, *topology, join=join)
    return found[0], topology.neighbours if guessed == guesses.CLOSED else found[1]


def _queue_unsigned_map(grid: Grid, verify: Verify, vertices: Tensor, faces: Tensor) -> tuple[Tensor]:
    with beside(faces.device) as join:
        _, _, neighbours = queue_pairing(faces, vertices.shape[0])
    none = faces.new_empty((0, 2))
    within = faces.clamp(0, vertices.shape[0] - 1)
    structure, pending = build_beside(vertices[None], within, MeshTopology(neighbours, none, none), join)
    return (structure_slab(structure, grid, 0, grid.shape[0], signed=False, pending=pending)[0],)


def _queue_index_map(
    sizes: Sizes, grid: Grid, verify: Verify, block: Tensor, *, signed: bool = True
) -> tuple[Tensor, Tensor]:
    return structure_slab(
        AccelerationStructure.in_block(sizes, block.device, block), grid, 0, grid.shape[0], signed=signed
    )
