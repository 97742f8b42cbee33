"""Gradients of signed distances.

The gradient with respect to a point is the unit vector away from the inside; with respect to the corners of the closest
triangle it is minus that vector times the closest point's barycentric coordinates. On the surface itself the vector is
the face's normal. The gradient of the sign is zero. There are no second derivatives: asking for one is an error.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from sdm.engine.acceleration import tensors_of_mesh

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# Points of a grid that the backward pass looks up at a time.
BACKWARD_CHUNK = 1 << 22


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


def closest_setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    """Keep what `closest_backward` needs."""
    vertices, faces, at, hierarchy, _ = inputs
    ctx.tensors = len(hierarchy)
    ctx.mark_non_differentiable(output[1], output[2], output[3])
    ctx.save_for_backward(vertices, faces, at, *output)


def closest_backward(ctx: Any, grad: Tensor, *_: Tensor) -> tuple[Any, ...]:
    """Gradients of `closest` in the vertices and the points."""
    vertices, faces, at, values, point, face, barycentric = ctx.saved_tensors
    # Where the value is NaN, so may be the gradient that comes back.
    grad = grad.masked_fill(face < 0, 0.0)
    flow = grad[:, None] * outward(vertices, faces, at, values, point, face)
    to_vertices = _to_vertices(vertices, faces, face, barycentric, flow) if ctx.needs_input_grad[0] else None
    return to_vertices, None, flow if ctx.needs_input_grad[2] else None, [None] * ctx.tensors, None


def map_setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    """Keep what `map_backward` needs."""
    vertices, faces, hierarchy, ctx.kind, ctx.origin, ctx.spacing, ctx.shape, ctx.first, ctx.direction = inputs
    ctx.mark_non_differentiable(output[1])
    ctx.save_for_backward(vertices, faces, *hierarchy)


def map_backward(ctx: Any, grad: Tensor, _: Tensor) -> tuple[Any, ...]:
    """Gradient of `distance_map` in the vertices."""
    vertices, faces, *hierarchy = ctx.saved_tensors
    result = torch.zeros_like(vertices)
    chunk = max(1, BACKWARD_CHUNK // max(1, ctx.shape[1] * ctx.shape[2]))
    for mesh in range(vertices.shape[0]):
        tensors = tensors_of_mesh(hierarchy, mesh, vertices.shape[0])
        for begin in range(0, ctx.shape[0], chunk):
            end = min(begin + chunk, ctx.shape[0])
            at = _centres(ctx, begin, end, grad.device)
            values, point, face, barycentric = torch.ops.sdm.closest(vertices[mesh], faces, at, tensors, ctx.kind)
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
