"""Derivatives of a family's vertices by its parameters, all at once, by forward-mode differentiation."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor
from torch.autograd import forward_ad

from sdm.errors import MeshError
from sdm.shapes import Cochlea, Family
from sdm.shapes.cochlea_reference import reference_vertices


def vertices_with_jacobian(family: Family, theta: Tensor) -> tuple[Tensor, Tensor]:
    """Vertices (V,3) and d vertices / d theta (V,3,P), float64, on theta's device.

    Args:
        family: A `Cochlea`, or a family whose `vertices` is plain torch code.
        theta: (P,) float64.

    Raises:
        MeshError: The family's vertices come from an operator without forward-mode derivatives.
    """
    # One pass for all parameters: as many copies of theta, each with a tangent along another parameter.
    at, count = theta.double(), theta.numel()
    try:
        with _quiet(), forward_ad.dual_level():
            copies = forward_ad.make_dual(at.repeat(count, 1), torch.eye(count, dtype=at.dtype, device=at.device))
            value, tangent = forward_ad.unpack_dual(_batch_of(family, copies))
    except (NotImplementedError, RuntimeError) as error:
        raise MeshError(
            f"the vertices of {family.name} have no forward-mode derivatives: write its vertices() in plain torch"
        ) from error
    if tangent is None:
        tangent = torch.zeros_like(value)
    return value[0].double(), tangent.double().permute(1, 2, 0).contiguous()


def vertices_of(family: Family, theta: Tensor) -> Tensor:
    """Vertices (V,3) float64 for theta (P,): as precise as the family's code allows."""
    return _batch_of(family, theta[None])[0].double()


def _batch_of(family: Family, theta: Tensor) -> Tensor:
    if isinstance(family, Cochlea):
        # Its operator is float32; the plain twin takes any type.
        tables = family._on(theta.device, "tables", lambda: family._tables)
        return reference_vertices(theta.double(), tables)
    return family.vertices(theta)


def with_jacobian(function: Callable[[Tensor], Tensor], at: Tensor) -> tuple[Tensor, Tensor]:
    """`function(at)` of any shape S for `at` (P,), and its derivatives (*S,P), by forward mode."""

    def twice(x: Tensor) -> tuple[Tensor, Tensor]:
        value = function(x)
        return value, value

    with _quiet():
        jacobian, value = torch.func.jacfwd(twice, has_aux=True)(at)
    return value, jacobian


@contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        # Torch's own forward mode uses it.
        warnings.filterwarnings("ignore", message=".*torch.jit.script. is deprecated", category=DeprecationWarning)
        warnings.filterwarnings("ignore", message=".*torch.jit.script. is not supported", category=DeprecationWarning)
        yield
