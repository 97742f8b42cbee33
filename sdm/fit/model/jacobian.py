"""Derivatives of a family's vertices by its parameters, all at once, by forward-mode differentiation."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor
from torch.autograd import forward_ad

from sdm.errors import MeshError
from sdm.shapes import Family

NO_DERIVATIVES = "the vertices of {} have no forward-mode derivatives: write its vertices() in plain torch"


def vertices_with_jacobian(family: Family, theta: Tensor) -> tuple[Tensor, Tensor]:
    """Vertices (V,3) and d vertices / d theta (V,3,P), float64, on theta's device.

    Args:
        family: One whose `reference_vertices` are plain torch code.
        theta: (P,) float64.

    Raises:
        MeshError: The family's vertices come from an operator without forward-mode derivatives.
    """
    at = theta.double()
    try:
        # A row for each parameter, which moves alone: one pass of a batch costs less than `torch.func` takes for it.
        with _torch_uses_its_own(), forward_ad.dual_level():
            rows = forward_ad.make_dual(at.expand(len(at), -1).contiguous(), torch.eye(len(at)).to(at))
            found = forward_ad.unpack_dual(family.reference_vertices(rows))
    except (NotImplementedError, RuntimeError) as error:
        raise MeshError(NO_DERIVATIVES.format(family.name)) from error
    if found.tangent is None:
        raise MeshError(NO_DERIVATIVES.format(family.name))
    return found.primal[0].double(), found.tangent.permute(1, 2, 0).double()


def vertices_of(family: Family, theta: Tensor) -> Tensor:
    """Vertices (V,3) float64 for theta (P,): as precise as the family's code allows."""
    return family.reference_vertices(theta.double()[None])[0].double()


def with_jacobian(function: Callable[[Tensor], Tensor], at: Tensor) -> tuple[Tensor, Tensor]:
    """`function(at)` of any shape S for `at` (P,), and its derivatives (*S,P), by forward mode."""

    def twice(x: Tensor) -> tuple[Tensor, Tensor]:
        value = function(x)
        return value, value

    with _torch_uses_its_own():
        jacobian, value = torch.func.jacfwd(twice, has_aux=True)(at)
    return value, jacobian


@contextmanager
def _torch_uses_its_own() -> Iterator[None]:
    """Without the warnings of what torch's own forward mode uses and torch has deprecated."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.script. is deprecated", category=DeprecationWarning)
        warnings.filterwarnings("ignore", message=".*torch.jit.script. is not supported", category=DeprecationWarning)
        yield
