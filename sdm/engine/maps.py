"""Whole maps, from vertices and faces to values: queued step by step, or all at once from a recording.

Each call without gradients on a GPU is a function of a few tensors that queues kernels and does nothing else, so that
`sdm.runtime.cuda_graphs` can record it. What a mesh's faces say by themselves is looked up beforehand, with one
exception: as soon as such calls are recorded, faces never seen before are taken for those of a closed mesh, or of one
with as many boundary edges as the last open one of as many vertices and faces. What they say is read while the map is
under way; if the guess was wrong, the map is thrown away and made anew.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator
from functools import partial

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine import ops
from sdm.engine.acceleration import build, check_count, queue_build, topology_for
from sdm.engine.ops import map_slab
from sdm.errors import GridError
from sdm.kernels.dense.cost_model import THINNEST_SLAB
from sdm.runtime import cuda_graphs
from sdm.runtime.captured_call import Work
from sdm.runtime.graph_branches import Join, beside
from sdm.topology.boundary_edges import (
    MeshTopology,
    guess,
    is_known,
    leaves_none_over,
    queue_joining,
    queue_pairing,
    remember_closed,
    remember_open,
)

# A launch's indices are 32 bits wide.
LARGEST_SLAB = 1 << 30
# Larger results are not worth a recording: their kernels take longer than it takes to launch them.
LARGEST_RECORDED = 1 << 29


def slabs_of(grid: Grid, voxels: int) -> Iterator[tuple[int, int]]:
    """Layers (begin, end) of slabs with about as many voxels.

    Raises:
        GridError: The thinnest slab has more voxels than a launch can count.
    """
    if _thinnest(grid) > LARGEST_SLAB:
        raise GridError(
            f"{THINNEST_SLAB} layers of a grid of shape {grid.shape} have more than {LARGEST_SLAB:,} voxels: "
            "split it along y or z, or let x be its longest axis"
        )
    layers = max(THINNEST_SLAB, voxels // (grid.shape[1] * grid.shape[2]) // THINNEST_SLAB * THINNEST_SLAB)
    for begin in range(0, grid.shape[0], layers):
        yield begin, min(begin + layers, grid.shape[0])


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


def is_replayable(vertices: Tensor, grid: Grid, meshes: int = 1) -> bool:
    """Whether maps of these vertices may be recorded and replayed."""
    return meshes * grid.nbytes <= LARGEST_RECORDED and cuda_graphs.serves(vertices)


def map_of(vertices: Tensor, faces: Tensor, grid: Grid) -> tuple[Tensor, Tensor | None]:
    """The map (nx,ny,nz) of a replayable mesh, and how many voxels are ambiguous (1,), None for a closed mesh."""
    vertices, count = vertices.detach(), vertices.shape[0]
    if is_known(faces, count):
        values, ambiguous = _maps(vertices[None], faces, grid, None)
        return values[0], ambiguous
    kind, work = _guessed(faces, count, grid)
    found = cuda_graphs.replayed(kind, (vertices, faces))
    if found is not None:
        if work is _closed_map:
            remember_closed(faces, count, found[1])
            return found[0][0], None
        return found[0][0], found[1]
    topology = topology_for(vertices, faces)
    remember_open(faces, count, topology.boundary)
    kind, work = _guessed(faces, count, grid)
    if work is _closed_map and not leaves_none_over(faces, count):
        values, ambiguous = _maps(vertices[None], faces, grid, None)
        return values[0], ambiguous
    made = _known_maps(grid, cuda_graphs.unheard, vertices[None], faces, *topology)
    cuda_graphs.note(kind, partial(work, grid), (vertices, faces))
    return made[0][0], made[1] if len(made) > 1 else None


def _guessed(faces: Tensor, count: int, grid: Grid) -> tuple[Hashable, Work]:
    """What kind of call a map is if the guess about its faces is right, and the work that is recorded for it."""
    numbers = guess(faces, count)
    kind = "closed" if numbers is None else "open", count, faces.shape[0], numbers, grid, ops.DENSE_METHOD
    return kind, _closed_map if numbers is None else partial(_open_map, numbers)


def batch_maps(vertices: Tensor, faces: Tensor, grid: Grid, edges: Tensor | None) -> Tensor:
    """`sdm.signed_distance_maps` of tensors that are known to fit; with the boundary `edges` (E,2) it never waits."""
    if is_replayable(vertices, grid, vertices.shape[0]):
        check_count(vertices, faces)
        return _maps(vertices.detach().contiguous(), faces.contiguous(), grid, edges)[0]
    most = max(1, LARGEST_SLAB // _thinnest(grid))
    if vertices.shape[0] > most:
        return torch.cat([batch_maps(some, faces, grid, edges) for some in vertices.split(most)])
    structure = build(vertices.detach(), faces, edges)
    slabs = slabs_of(grid, LARGEST_SLAB // vertices.shape[0])
    return put_together(
        ((begin, end, map_slab(vertices, faces, structure, grid, begin, end)[0]) for begin, end in slabs),
        grid.shape[0],
    )


def _maps(vertices: Tensor, faces: Tensor, grid: Grid, edges: Tensor | None) -> tuple[Tensor, Tensor | None]:
    """Replayable maps (B,nx,ny,nz), and how many voxels are ambiguous (B,), None for closed meshes."""
    topology = topology_for(vertices, faces, edges)
    kind = "known", vertices.shape, faces.shape[0], topology.boundary.shape[0], grid, ops.DENSE_METHOD
    inputs = vertices, faces, *topology
    found = cuda_graphs.replayed(kind, inputs)
    if found is None:
        work = partial(_known_maps, grid)
        found = work(cuda_graphs.unheard, *inputs)
        cuda_graphs.note(kind, work, inputs)
    return found[0], found[1] if len(found) > 1 else None


def _known_maps(
    grid: Grid,
    say: cuda_graphs.Say,
    vertices: Tensor,
    faces: Tensor,
    shared: Tensor,
    edges: Tensor,
    around: Tensor,
    *,
    join: Join | None = None,
) -> tuple[Tensor, ...]:
    structure = queue_build(vertices, faces, MeshTopology(shared, edges, around), join)
    found = map_slab(vertices, faces, structure, grid, 0, grid.shape[0])
    return found if edges.shape[0] else found[:1]


def _closed_map(grid: Grid, say: cuda_graphs.Say, vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """The map (1,nx,ny,nz) of a mesh that is closed if the remarks are zero, and its neighbours (F,4)."""
    with beside(faces.device) as join:
        remarks, _, shared = queue_pairing(faces, vertices.shape[0])
        say(remarks)
    # The kernels after this trust the faces, which only later turn out to be out of range.
    within = faces.clamp(0, vertices.shape[0] - 1)
    none = faces.new_empty((0, 2))
    return _known_maps(grid, say, vertices[None], within, shared, none, none, join=join)[0], shared


def _open_map(
    numbers: tuple[int, int], grid: Grid, say: cuda_graphs.Say, vertices: Tensor, faces: Tensor
) -> tuple[Tensor, Tensor]:
    """The map (1,nx,ny,nz), and how many voxels are ambiguous (1,), of an open mesh.

    If the remarks are zero: so many edges are left over, and so many bound it, as `numbers` say.
    """
    last = vertices.shape[0] - 1
    with beside(faces.device) as join:
        found, left_over, shared = queue_pairing(faces, vertices.shape[0])
        remarks, bounds, around = queue_joining(left_over, found, vertices[None], *numbers)
        say(remarks)
        # As above.
        edges = bounds.clamp(0, last)
    values, ambiguous = _known_maps(grid, say, vertices[None], faces.clamp(0, last), shared, edges, around, join=join)
    return values, ambiguous
