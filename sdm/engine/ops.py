"""The engine as torch operators: `torch.ops.sdm.*`, with fake implementations and gradients.

The gradient of a signed distance with respect to its point is the unit vector away from the inside; with respect to
the corners of the closest triangle it is minus that vector times the closest point's barycentric coordinates. On the
surface itself the vector is the face's normal. The gradient of the sign is zero. There are no second derivatives:
asking for one is an error.

An empty list of hierarchy tensors means: build one here, and let it go afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.engine.acceleration import build, one_of, unpack
from sdm.engine.thick_slices import AS_IT_IS, Slices, Triple, finer, has_room, measured_finer, scales_of
from sdm.kernels.dense import query as dense
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.points.query import query_points, query_winding, sort_points
from sdm.kernels.winding.column_sums import slab_winding
from sdm.runtime.graph_branches import kernels_beside
from sdm.runtime.operators import define, differentiate
from sdm.runtime.output_slot import current_place
from sdm.runtime.torch_warp import as_warp, on_current_stream, scratch_on

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# How maps are computed: "cells" (fast), "search" (plain) or "auto"; tests compare them.
DENSE_METHOD = "auto"
# And distances of points: "lists" (fast on a GPU), "search" (plain) or "auto".
POINTS_METHOD = "auto"
# Fewer points than this are queried in the order they come in.
SMALLEST_SORT = 1 << 12
# Points of a grid that the backward pass looks up at a time.
BACKWARD_CHUNK = 1 << 22
# Points of one launch: twice as many are counted with 32 bits.
MOST_POINTS = 1 << 29


def _query(
    vertices: Tensor,
    faces: Tensor,
    at: Tensor,
    tensors: list[Tensor],
    kind: int,
    hits: bool,
    cube: Sequence[float] | None = None,
) -> list[Tensor]:
    if not tensors:
        tensors, kind = build(vertices[None], faces)
    count = at.shape[0]
    if count > MOST_POINTS:
        some = [_query(vertices, faces, part, tensors, kind, hits, cube) for part in at.split(MOST_POINTS)]
        return [torch.cat(parts) for parts in zip(*some, strict=True)]
    values = torch.empty(count, dtype=torch.float32, device=at.device)
    found = []
    if hits:
        found = [torch.empty_like(at), torch.empty(count, dtype=torch.int32, device=at.device), torch.empty_like(at)]
    sort = count >= SMALLEST_SORT
    keys = torch.empty(2 * count if sort else 0, dtype=torch.int64, device=at.device)
    order = torch.empty(2 * count if sort else 0, dtype=torch.int32, device=at.device)
    with on_current_stream(at, at, tensors[0]):
        hierarchy, winding, _, parts, cones = unpack(tensors, kind, 1)
        where = as_warp(at, wp.vec3)
        by = as_warp(order, wp.int32)
        if sort:
            sort_points(where, hierarchy, as_warp(keys, wp.int64), by, cube)
        room = None
        if hits:
            room = (as_warp(found[0], wp.vec3), as_warp(found[1], wp.int32), as_warp(found[2], wp.vec3))
        query_points(
            hierarchy,
            parts,
            cones,
            winding,
            where,
            by,
            as_warp(values, wp.float32),
            room,
            scratch_on(at.device),
            POINTS_METHOD,
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
    return _query(vertices, faces, points.contiguous(), hierarchy, kind, hits=False, cube=cube)[0]


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
    values, point, face, barycentric = _query(vertices, faces, points.contiguous(), hierarchy, kind, hits=True)
    return values, point, face, barycentric


class _Once(torch.autograd.Function):
    """Passes `direction` on; whoever differentiates it further is told, not misled."""

    @staticmethod
    def forward(ctx: Any, direction: Tensor, *depends_on: Tensor) -> Tensor:
        return direction.view_as(direction)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, ...]:
        raise NotImplementedError("signed distances can be differentiated once; second derivatives are not there")


def outward(vertices: Tensor, faces: Tensor, at: Tensor, values: Tensor, point: Tensor, face: Tensor) -> Tensor:
    """Unit vectors (N,3) along which the signed distance grows: away from the closest point, or the face's normal.

    Zero for a point that is not finite: its value is NaN, but the gradients of all others stay clean.
    """
    with torch.no_grad():
        direction = _outward(vertices, faces, at, values, point, face)
    return _Once.apply(direction, vertices, at) if torch.is_grad_enabled() else direction


def _outward(vertices: Tensor, faces: Tensor, at: Tensor, values: Tensor, point: Tensor, face: Tensor) -> Tensor:
    away = (at - point) / values[:, None]
    corners = vertices[faces[face.clamp(min=0).long()].long()].double()
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1, eps=0.0).nan_to_num(0.0).to(away.dtype)
    # Within a few roundings of the surface the difference above is noise.
    scale = torch.maximum(at.abs().amax(1), point.abs().amax(1))
    near = values.abs() <= 8 * torch.finfo(torch.float32).eps * scale
    away = torch.where(near[:, None], normal, away)
    return torch.nn.functional.normalize(away, dim=1).masked_fill(face[:, None] < 0, 0.0)


def _to_vertices(vertices: Tensor, faces: Tensor, face: Tensor, barycentric: Tensor, flow: Tensor) -> Tensor:
    """Sum of -barycentric * flow over the corners of the closest faces: (V,3)."""
    weighted = -barycentric.masked_fill(face[:, None] < 0, 0.0)[:, :, None] * flow[:, None, :]
    corners = faces[face.clamp(min=0).long()].long()
    return torch.zeros_like(vertices).index_add_(0, corners.reshape(-1), weighted.reshape(-1, 3))


def _closest_setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    vertices, faces, at, hierarchy, _ = inputs
    ctx.tensors = len(hierarchy)
    ctx.mark_non_differentiable(output[1], output[2], output[3])
    ctx.save_for_backward(vertices, faces, at, *output)


def _closest_backward(ctx: Any, grad: Tensor, *_: Tensor) -> tuple[Any, ...]:
    vertices, faces, at, values, point, face, barycentric = ctx.saved_tensors
    # Where the value is NaN, so may be the gradient that comes back.
    grad = grad.masked_fill(face < 0, 0.0)
    flow = grad[:, None] * outward(vertices, faces, at, values, point, face)
    to_vertices = _to_vertices(vertices, faces, face, barycentric, flow) if ctx.needs_input_grad[0] else None
    return to_vertices, None, flow if ctx.needs_input_grad[2] else None, [None] * ctx.tensors, None


differentiate("closest", _closest_backward, _closest_setup)


def _fake_winding_number(vertices: Tensor, faces: Tensor, points: Tensor, hierarchy: list[Tensor], kind: int) -> Tensor:
    return points.new_empty(points.shape[0])


@define("winding_number", _fake_winding_number)
def winding_number(vertices: Tensor, faces: Tensor, points: Tensor, hierarchy: list[Tensor], kind: int) -> Tensor:
    """Generalised winding number (N,) of a mesh about points (N,3)."""
    if not hierarchy:
        hierarchy, kind = build(vertices[None], faces)
    at = points.contiguous()
    values = torch.empty(at.shape[0], dtype=torch.float32, device=at.device)
    with on_current_stream(at, at, hierarchy[0]):
        tree, winding, *_ = unpack(hierarchy, kind, 1)
        for some, found in zip(at.split(MOST_POINTS), values.split(MOST_POINTS), strict=True):
            query_winding(tree, winding, as_warp(some, wp.vec3), as_warp(found, wp.float32))
    return values


@lru_cache(maxsize=64)
def _slab(
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
    if direction != IDENTITY:
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
    meshes = vertices.shape[0]
    if not hierarchy:
        hierarchy, kind = build(vertices, faces)
    slices = Slices(tuple(spacing), tuple(shape), first)
    query = partial(_query_slices, tuple(origin), tuple(direction), kind)
    # Of a GPU's meshes the host does not know how large they are.
    if vertices.device.type != "cpu" or DENSE_METHOD == "search":
        return query(hierarchy, meshes, slices, AS_IT_IS)
    tree = unpack(hierarchy, kind, meshes)[0]
    scales = scales_of(tree, meshes)
    wanted = {scale: finer(slices, scale, tree.count) for scale in set(scales)}
    times = [wanted[scale] for scale in scales]
    if len(set(times)) == 1 and has_room(slices, times[0], meshes):
        return query(hierarchy, meshes, slices, times[0])
    # One by one, so that what a mesh's map is does not depend on the others of the batch.
    found = [query(one_of(hierarchy, mesh, meshes), 1, slices, times[mesh]) for mesh in range(meshes)]
    values, ambiguous = zip(*found, strict=True)
    return torch.cat(values), torch.cat(ambiguous)


def _query_slices(
    origin: tuple[float, ...],
    direction: tuple[float, ...],
    kind: int,
    hierarchy: list[Tensor],
    meshes: int,
    slices: Slices,
    times: Triple,
) -> tuple[Tensor, Tensor]:
    """What `distance_map` returns, measured on a grid with `times` as many slices."""
    device = hierarchy[0].device
    values = torch.empty((meshes, *slices.shape), dtype=torch.float32, device=device)
    with on_current_stream(values, hierarchy[0]):
        tree, winding, frames, parts, cones = unpack(hierarchy, kind, meshes)

        def measure(winding: Any, slices: Slices, values: Tensor) -> Tensor:
            ambiguous = torch.zeros(meshes, dtype=torch.int32, device=device)
            place = current_place()
            dense.query_slab(
                tree,
                frames,
                parts,
                cones,
                winding,
                _slab(origin, slices.spacing, slices.shape, slices.first, direction),
                as_warp(values, wp.float32),
                as_warp(ambiguous, wp.int32),
                None if place is None else as_warp(place.take(values), wp.int64),
                scratch_on(device),
                partial(kernels_beside, values),
                DENSE_METHOD,
            )
            return ambiguous

        if times == AS_IT_IS:
            return values, measure(winding, slices, values)
        slab = _slab(origin, slices.spacing, slices.shape, slices.first, direction)
        slab_winding(tree, winding, slab, as_warp(values, wp.float32), scratch_on(device))
        return values, measured_finer(values, slices, times, partial(measure, None))


def _map_setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    vertices, faces, hierarchy, ctx.kind, ctx.origin, ctx.spacing, ctx.shape, ctx.first, ctx.direction = inputs
    ctx.mark_non_differentiable(output[1])
    ctx.save_for_backward(vertices, faces, *hierarchy)


def _map_backward(ctx: Any, grad: Tensor, _: Tensor) -> tuple[Any, ...]:
    vertices, faces, *hierarchy = ctx.saved_tensors
    result = torch.zeros_like(vertices)
    chunk = max(1, BACKWARD_CHUNK // max(1, ctx.shape[1] * ctx.shape[2]))
    for mesh in range(vertices.shape[0]):
        tensors, kind = (one_of(hierarchy, mesh, vertices.shape[0]), ctx.kind) if hierarchy else ([], ctx.kind)
        for begin in range(0, ctx.shape[0], chunk):
            end = min(begin + chunk, ctx.shape[0])
            at = _centres(ctx, begin, end, grad.device)
            values, point, face, barycentric = torch.ops.sdm.closest(vertices[mesh], faces, at, tensors, kind)
            flow = grad[mesh, begin:end].reshape(-1, 1) * outward(vertices[mesh], faces, at, values, point, face)
            result[mesh] += _to_vertices(vertices[mesh], faces, face, barycentric, flow)
    return result, None, [None] * len(hierarchy), None, None, None, None, None, None


def _centres(ctx: Any, begin: int, end: int, device: torch.device) -> Tensor:
    """Voxel centres (N,3) float32 of part of the slab, as the kernels see them."""
    ranges = ((ctx.first + begin, ctx.first + end), (0, ctx.shape[1]), (0, ctx.shape[2]))
    # Numbers, not tensors of numbers: copying those to a GPU would wait for it.
    steps = [torch.arange(low, high, device=device, dtype=torch.float64) for low, high in ranges]
    steps = torch.meshgrid(*(n * s for n, s in zip(steps, ctx.spacing, strict=True)), indexing="ij")
    if tuple(ctx.direction) == IDENTITY:
        at = [step + o for step, o in zip(steps, ctx.origin, strict=True)]
    else:
        rows = [ctx.direction[3 * row : 3 * row + 3] for row in range(3)]
        at = [
            sum(d * step for d, step in zip(row, steps, strict=True)) + o
            for row, o in zip(rows, ctx.origin, strict=True)
        ]
    return torch.stack(at, -1).reshape(-1, 3).float()


differentiate("distance_map", _map_backward, _map_setup)
