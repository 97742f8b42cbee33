"""Turn a family's Warp kernel into a torch operator with a fake implementation and a gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.runtime.operators import define, differentiate
from sdm.runtime.torch_warp import as_warp, on_current_stream

VertexOp = Callable[[Tensor, list[Tensor], int], Tensor]


def vertex_op(
    name: str, fill: Callable[..., None], add_gradient: Callable[..., None], dtypes: Sequence[Any]
) -> VertexOp:
    """Register `torch.ops.sdm.<name>(theta, tables, count) -> vertices`.

    Args:
        name: Name of the operator; its gradient is `<name>_backward`.
        fill: `fill(theta, tables, vertices, device)` on Warp arrays.
        add_gradient: `add_gradient(theta, tables, vertices, upstream, gradient, device)` on Warp arrays.
        dtypes: Warp element type of each table.

    Returns:
        The operator: theta (B,P) float32 and `count` V to vertices (B,V,3) float32, on torch's current stream,
        without waiting for the device. Differentiable in theta, once.
    """

    def as_tables(tables: list[Tensor]) -> list[Any]:
        return [as_warp(t, d) for t, d in zip(tables, dtypes, strict=True)]

    def forward(theta: Tensor, tables: list[Tensor], count: int) -> Tensor:
        theta = theta.contiguous()
        vertices = theta.new_empty(theta.shape[0], count, 3)
        if vertices.numel():
            with on_current_stream(theta, theta, *tables) as device:
                fill(as_warp(theta, wp.float32), as_tables(tables), as_warp(vertices, wp.vec3), device)
        return vertices

    def backward(theta: Tensor, tables: list[Tensor], upstream: Tensor) -> Tensor:
        theta = theta.contiguous()
        # Warp's adjoint of a store may clear what it reads, and an operator must not change its inputs.
        upstream = upstream.to(torch.float32).clone(memory_format=torch.contiguous_format)
        scratch = torch.empty_like(upstream)
        gradient = torch.zeros_like(theta)
        if upstream.numel():
            with on_current_stream(theta, theta, *tables) as device:
                add_gradient(
                    as_warp(theta, wp.float32),
                    as_tables(tables),
                    as_warp(scratch, wp.vec3),
                    as_warp(upstream, wp.vec3),
                    as_warp(gradient, wp.float32),
                    device,
                )
        return gradient

    def fake_vertices(theta: Tensor, tables: list[Tensor], count: int) -> Tensor:
        return theta.new_empty(theta.shape[0], count, 3)

    def fake_gradient(theta: Tensor, tables: list[Tensor], upstream: Tensor) -> Tensor:
        return torch.empty_like(theta, memory_format=torch.contiguous_format)

    define(name, fake_vertices)(forward)
    define(f"{name}_backward", fake_gradient)(backward)
    forward_op: VertexOp = getattr(torch.ops.sdm, name)
    backward_op = getattr(torch.ops.sdm, f"{name}_backward")

    def remember(ctx: Any, inputs: tuple[Tensor, list[Tensor], int], output: Tensor) -> None:
        theta, tables, _ = inputs
        ctx.save_for_backward(theta, *tables)

    def gradient(ctx: Any, upstream: Tensor) -> tuple[Tensor, list[None], None]:
        theta, *tables = ctx.saved_tensors
        return backward_op(theta, tables, upstream), [None] * len(tables), None

    differentiate(name, gradient, remember)
    return forward_op
