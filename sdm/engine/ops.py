"""The engine as torch operators: `torch.ops.sdm.*`, with fake implementations and gradients (`sdm.engine.gradients`).

Operators take an acceleration structure as its tensors and its kind; no tensors mean: build one here, and let it go
afterwards. Eager calls without gradients go past torch's dispatcher, whose work takes the host as long as some kernels:
`points_distance`, `points_closest`, `points_winding` and `map_slab` choose the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine import gradients
from sdm.engine.acceleration import AccelerationStructure, build
from sdm.engine.plan_override import OPTIONS
from sdm.engine.thick_slices import AS_IT_IS, Slices, Triple, finer, has_room, measured_finer, scales_of
from sdm.kernels.dense import query as dense
from sdm.kernels.dense.plan import Workload, make_plan, memory_of
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.plan_options import PlanOptions
from sdm.kernels.points.plan import plan_points
from sdm.kernels.points.query import query_points, query_winding, sort_points
from sdm.kernels.winding.column_sums import slab_winding
from sdm.runtime.graphs.branches import WINDING, kernels_beside
from sdm.runtime.graphs.output_slot import current_slot
from sdm.runtime.operators import define, differentiate, is_eager
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace

# Fewer points than this are queried in the order they come in, on a CPU far fewer of meshes that are not tiny: each
# search begins with the answer of the point before.
SMALLEST_SORT, CPU_SORT, CPU_SORT_TRIANGLES = 1 << 12, 1 << 8, 1 << 8
# Points of one launch: twice as many are counted with 32 bits.
MOST_POINTS = 1 << 29


def _structure(vertices: Tensor, faces: Tensor, tensors: list[Tensor], kind: int) -> AccelerationStructure:
    """The structure that an operator was given, or a new one of meshes (B,V,3)."""
    if not tensors:
        return build(vertices, faces)
    return AccelerationStructure.from_tensors(tensors, kind, vertices.shape[0])


def is_sorted(count: int, faces: int, gpu: bool) -> bool:
    """True if so many points of a mesh with so many faces are gone through along a curve."""
    return count >= SMALLEST_SORT or (not gpu and count >= CPU_SORT and faces >= CPU_SORT_TRIANGLES)


def _query(
    at: Tensor, structure: AccelerationStructure, hits: bool, cube: Sequence[float] | None = None
) -> list[Tensor]:
    """Signed distances of contiguous points (N,3), and with `hits` the closest points, faces and coordinates."""
    count = at.shape[0]
    if count > MOST_POINTS:
        some = [_query(part, structure, hits, cube) for part in at.split(MOST_POINTS)]
        return [torch.cat(parts) for parts in zip(*some, strict=True)]
    values = torch.empty(count, dtype=torch.float32, device=at.device)
    found = []
    if hits:
        found = [torch.empty_like(at), torch.empty(count, dtype=torch.int32, device=at.device), torch.empty_like(at)]
    sort = is_sorted(count, structure.sizes.faces, at.is_cuda)
    keys = torch.empty(2 * count if sort else 0, dtype=torch.int64, device=at.device)
    order = torch.empty(2 * count if sort else 0, dtype=torch.int32, device=at.device)
    with on_current_stream(at, at, structure.memory[0]):
        tree, winding, _, features, cones = structure.view
        where, empty = as_warp(at, wp.vec3), workspace(at.device)
        by = as_warp(order, wp.int32)
        if sort:
            sort_points(where, empty(0, wp.int32), tree, as_warp(keys, wp.int64), by, cube)
        room = None
        if hits:
            room = (as_warp(found[0], wp.vec3), as_warp(found[1], wp.int32), as_warp(found[2], wp.vec3))
        query_points(
            tree,
            features,
            cones,
            winding,
            where,
            by,
            as_warp(values, wp.float32),
            room,
            empty,
            plan_points(count, at.is_cuda, OPTIONS.get()),
        )
    return [values, *found]


def _fake_distance(
    vertices: Tensor,
    faces: Tensor,
    points: Tensor,
    hierarchy: list[Tensor],
    kind: int,
    cube: Sequence[float] | None = None,
) -> Tensor:
    return points.new_empty(points.shape[0])


@define("distance", _fake_distance)
def distance(
    vertices: Tensor,
    faces: Tensor,
    points: Tensor,
    hierarchy: list[Tensor],
    kind: int,
    cube: Sequence[float] | None = None,
) -> Tensor:
    """Signed distance (N,) of points (N,3) from a mesh; no gradients (see `closest`).

    The points are gone through along a curve in a `cube` (least x, y and z, edge), by default twice the mesh's box.
    """
    structure = _structure(vertices[None], faces, hierarchy, kind)
    return _query(points.contiguous(), structure, hits=False, cube=cube)[0]


def _fake_closest(
    vertices: Tensor, faces: Tensor, points: Tensor, hierarchy: list[Tensor], kind: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    count = points.shape[0]
    face = points.new_empty(count, dtype=torch.int32)
    return points.new_empty(count), points.new_empty(count, 3), face, points.new_empty(count, 3)


@define("closest", _fake_closest)
def closest(
    vertices: Tensor, faces: Tensor, points: Tensor, hierarchy: list[Tensor], kind: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Signed distance (N,), closest point (N,3), face (N,) and barycentric coordinates (N,3)."""
    structure = _structure(vertices[None], faces, hierarchy, kind)
    values, point, face, barycentric = _query(points.contiguous(), structure, hits=True)
    return values, point, face, barycentric


def _fake_winding_number(vertices: Tensor, faces: Tensor, points: Tensor, hierarchy: list[Tensor], kind: int) -> Tensor:
    return points.new_empty(points.shape[0])


@define("winding_number", _fake_winding_number)
def winding_number(vertices: Tensor, faces: Tensor, points: Tensor, hierarchy: list[Tensor], kind: int) -> Tensor:
    """Generalised winding number (N,) of a mesh about points (N,3)."""
    return _winding(points.contiguous(), _structure(vertices[None], faces, hierarchy, kind))


def _winding(at: Tensor, structure: AccelerationStructure) -> Tensor:
    values = torch.empty(at.shape[0], dtype=torch.float32, device=at.device)
    with on_current_stream(at, at, structure.memory[0]):
        for some, found in zip(at.split(MOST_POINTS), values.split(MOST_POINTS), strict=True):
            query_winding(
                structure.view.tree, structure.view.winding, as_warp(some, wp.vec3), as_warp(found, wp.float32)
            )
    return values


@lru_cache(maxsize=64)
def slab_view(
    origin: tuple[float, ...],
    spacing: tuple[float, ...],
    shape: tuple[int, ...],
    first: int,
    direction: tuple[float, ...],
) -> Any:
    """The kernels' view of a slab; nobody may write into it."""
    slab = Slab()
    slab.origin = wp.vec3d(*origin)
    slab.spacing = wp.vec3d(*spacing)
    slab.shape = wp.vec3i(*shape)
    slab.first = first
    if direction != gradients.IDENTITY:
        slab.turned = 1
        slab.axes = wp.mat33d(*(d * s for row in range(3) for d, s in zip(direction[3 * row :], spacing, strict=False)))
    return slab


def _fake_distance_map(
    vertices: Tensor,
    faces: Tensor,
    hierarchy: list[Tensor],
    kind: int,
    origin: Sequence[float],
    spacing: Sequence[float],
    shape: Sequence[int],
    first: int,
    direction: Sequence[float],
) -> tuple[Tensor, Tensor]:
    meshes = vertices.shape[0]
    return vertices.new_empty((meshes, *shape)), vertices.new_empty(meshes, dtype=torch.int32)


@define("distance_map", _fake_distance_map)
def distance_map(
    vertices: Tensor,
    faces: Tensor,
    hierarchy: list[Tensor],
    kind: int,
    origin: Sequence[float],
    spacing: Sequence[float],
    shape: Sequence[int],
    first: int,
    direction: Sequence[float],
) -> tuple[Tensor, Tensor]:
    """Signed distances (B,n,ny,nz) of meshes (B,V,3), and the number of ambiguous voxels of each (B,).

    `shape` is the slab's (n,ny,nz); its voxel (0,0,0) is the grid's voxel (first,0,0). `direction` is the grid's, row
    by row.
    """
    structure = _structure(vertices, faces, hierarchy, kind)
    return _slab_distances(structure, tuple(origin), tuple(direction), Slices(tuple(spacing), tuple(shape), first))


def _slab_distances(
    structure: AccelerationStructure,
    origin: tuple[float, ...],
    direction: tuple[float, ...],
    slices: Slices,
    signed: bool = True,
    pending: dense.Pending = dense.MADE,
) -> tuple[Tensor, Tensor]:
    options = OPTIONS.get()
    if structure.device.type == "cpu":
        # Nothing is beside anything else.
        pending.boundary()
        pending = dense.MADE
    query = partial(_query_slices, origin, direction, options, signed, pending)
    # Of a GPU's meshes the host does not know how large they are.
    if structure.device.type != "cpu" or options.method == "search":
        return query(structure, slices, AS_IT_IS)
    meshes = structure.sizes.meshes
    scales = scales_of(structure.view.tree, meshes)
    wanted = {scale: finer(slices, scale, structure.sizes.faces, options.slice_factors) for scale in set(scales)}
    times = [wanted[scale] for scale in scales]
    if set(times) == {AS_IT_IS} or (len(set(times)) == 1 and has_room(slices, times[0], meshes)):
        return query(structure, slices, times[0])
    # One by one, so that what a mesh's map is does not depend on the others of the batch.
    found = [query(structure.of_mesh(mesh), slices, times[mesh]) for mesh in range(meshes)]
    values, ambiguous = zip(*found, strict=True)
    return torch.cat(values), torch.cat(ambiguous)


def _query_slices(
    origin: tuple[float, ...],
    direction: tuple[float, ...],
    options: PlanOptions,
    signed: bool,
    pending: dense.Pending,
    structure: AccelerationStructure,
    slices: Slices,
    times: Triple,
) -> tuple[Tensor, Tensor]:
    """As `distance_map`, measured on a grid with `times` as many slices; without a sign if that is not wanted."""
    meshes, device = structure.sizes.meshes, structure.device
    values = torch.empty((meshes, *slices.shape), dtype=torch.float32, device=device)
    turned = direction != gradients.IDENTITY
    with on_current_stream(values, structure.memory[0]) as warp_device:
        tree, winding, frames, features, cones = structure.view
        surface = dense.Surface(tree, frames, features, cones)

        def measure(winding: Any, slices: Slices, values: Tensor) -> Tensor:
            ambiguous = torch.empty(meshes, dtype=torch.int32, device=device)
            given = as_warp(ambiguous, wp.int32)
            # The winding numbers' branch is waited for before any is counted.
            with kernels_beside(values, WINDING, since=pending.since):
                given.zero_()
            # Calls are recorded on a GPU alone.
            slot = current_slot() if values.is_cuda else None
            work = Workload(structure.sizes.faces, tree.depth, meshes, slices.shape, slices.spacing, turned)
            dense.query_slab(
                surface,
                winding,
                slab_view(origin, slices.spacing, slices.shape, slices.first, direction),
                dense.Target(
                    as_warp(values, wp.float32),
                    given,
                    None if slot is None else as_warp(slot.bind(values), wp.int64),
                ),
                make_plan(work, memory_of(warp_device.alias), options),
                workspace(device),
                partial(kernels_beside, values, WINDING),
                pending,
            )
            return ambiguous

        if times == AS_IT_IS:
            return values, measure(winding if signed else None, slices, values)
        slab = slab_view(origin, slices.spacing, slices.shape, slices.first, direction)
        if not signed:
            values.zero_()
            return values, measured_finer(values, slices, times, partial(measure, None), options.slab_voxels)
        slab_winding(tree, winding, slab, as_warp(values, wp.float32), workspace(device), options.most_columns)
        return values, measured_finer(values, slices, times, partial(measure, None), options.slab_voxels)


differentiate("closest", gradients.closest_backward, gradients.closest_setup)
differentiate("distance_map", gradients.map_backward, gradients.map_setup)


def points_distance(
    vertices: Tensor,
    faces: Tensor,
    points: Tensor,
    structure: AccelerationStructure | None,
    cube: Sequence[float] | None = None,
) -> Tensor:
    """The operator `distance`, of a structure that is there or of one that is built here."""
    if is_eager(vertices, points):
        return _query(points.contiguous(), structure or build(vertices.detach()[None], faces), hits=False, cube=cube)[0]
    return torch.ops.sdm.distance(vertices, faces, points, *_handed_over(structure), cube)


def points_closest(
    vertices: Tensor, faces: Tensor, points: Tensor, structure: AccelerationStructure | None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The operator `closest`, in the same way."""
    if is_eager(vertices, points):
        built = structure or build(vertices.detach()[None], faces)
        values, point, face, barycentric = _query(points.contiguous(), built, hits=True)
        return values, point, face, barycentric
    return torch.ops.sdm.closest(vertices, faces, points, *_handed_over(structure))


def points_winding(vertices: Tensor, faces: Tensor, points: Tensor, structure: AccelerationStructure | None) -> Tensor:
    """The operator `winding_number`, in the same way."""
    return torch.ops.sdm.winding_number(vertices, faces, points, *_handed_over(structure))


def map_slab(
    vertices: Tensor, faces: Tensor, structure: AccelerationStructure | None, grid: Grid, begin: int, end: int
) -> tuple[Tensor, Tensor]:
    """The operator `distance_map` for layers of a grid, in the same way: maps (B,end-begin,ny,nz), ambiguous (B,)."""
    if is_eager(vertices):
        return structure_slab(structure or build(vertices.detach(), faces, for_maps=True), grid, begin, end)
    shape = end - begin, grid.shape[1], grid.shape[2]
    direction = [x for row in grid.direction for x in row]
    return torch.ops.sdm.distance_map(
        vertices, faces, *_handed_over(structure), grid.origin, grid.spacing, shape, begin, direction
    )


def structure_slab(
    structure: AccelerationStructure,
    grid: Grid,
    begin: int,
    end: int,
    *,
    signed: bool = True,
    pending: dense.Pending = dense.MADE,
) -> tuple[Tensor, Tensor]:
    """`map_slab` of a structure that is there, past torch's dispatcher and without gradients; without a sign too.

    `pending`: what has to be called before parts of it are looked at.
    """
    slices = Slices(grid.spacing, (end - begin, *grid.shape[1:]), begin)
    direction = (*grid.direction[0], *grid.direction[1], *grid.direction[2])
    return _slab_distances(structure, grid.origin, direction, slices, signed, pending)


def _handed_over(structure: AccelerationStructure | None) -> tuple[list[Tensor], int]:
    return ([], 0) if structure is None else (structure.tensors, int(structure.kind))
