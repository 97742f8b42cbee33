"""Conjugate gradients for symmetric positive definite systems whose matrix is a function."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Product = Callable[[Tensor], Tensor]


def conjugate_gradients(
    product: Product, right: Tensor, steps: int, *, preconditioner: Product | None = None, accuracy: float = 0.0
) -> Tensor:
    """The solution x of `product(x) = right`, nearly.

    Args:
        product: The matrix, symmetric and positive definite.
        right: Of any shape.
        steps: At most so many.
        preconditioner: About the inverse of the matrix; the nearer it is, the fewer steps are needed.
        accuracy: Ends the steps where what is left is so many times what was there at first, which waits for a GPU; 0
            for all steps, without a wait.

    Returns:
        x, of the shape of `right`.
    """
    tiny = torch.finfo(right.dtype).tiny
    x, r = torch.zeros_like(right), right
    p = z = r if preconditioner is None else preconditioner(r)
    rz = (r * z).sum()
    enough = accuracy**2 * rz
    for _ in range(steps):
        image = product(p)
        step = rz / (p * image).sum().clamp_min(tiny)
        x, r = x + step * p, r - step * image
        z = r if preconditioner is None else preconditioner(r)
        new = (r * z).sum()
        if accuracy and float(new) < float(enough):
            break
        p, rz = z + new / rz.clamp_min(tiny) * p, new
    return x
