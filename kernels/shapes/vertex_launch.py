"""Launches of a family's kernel: vertices from parameters, and the gradient back."""

from __future__ import annotations

from typing import Any

from sdm.kernels.launch import launch_grid


def fill_vertices(kernel: Any, theta: Any, tables: list[Any], vertices: Any, device: Any) -> None:
    """Fill `vertices` (B,V) vec3 by a kernel of (theta (B,P), tables ..., vertices), one thread a vertex."""
    launch_grid(kernel, dim=vertices.shape, inputs=[theta, *tables], outputs=[vertices], device=device)


def add_gradient(
    kernel: Any, theta: Any, tables: list[Any], vertices: Any, upstream: Any, gradient: Any, device: Any
) -> None:
    """Add to `gradient` (B,P) what `upstream` (B,V) vec3, the gradient by vertices, gives by theta."""
    launch_grid(
        kernel,
        dim=vertices.shape,
        inputs=[theta, *tables],
        outputs=[vertices],
        adj_inputs=[gradient, *([None] * len(tables))],
        adj_outputs=[upstream],
        adjoint=True,
        device=device,
    )
