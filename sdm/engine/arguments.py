"""Arguments of the public calls: orientation, what grids are called in errors, and derivatives that there are not."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError
from sdm.inspect import orient_outward

Orient = Literal["keep", "auto"]


def oriented(mesh: TriangleMesh, orient: Orient) -> TriangleMesh:
    """The mesh, turned outward if that is wanted."""
    if orient not in ("keep", "auto"):
        raise MeshError(f"orient is {orient!r}; use 'keep' or 'auto'")
    return orient_outward(mesh) if orient == "auto" else mesh


def described(grid: Grid) -> str:
    """A map of this grid, as errors name it."""
    return f"a map of {' x '.join(map(str, grid.shape))} voxels"


def refuse_forward_mode(tensor: Tensor) -> None:
    """Refuse a tensor with a forward-mode derivative."""
    # Torch would take the derivatives of operators like these for zero, without a word.
    if not torch.compiler.is_compiling() and unpack_dual(tensor).tangent is not None:
        raise NotImplementedError(
            "signed distances have derivatives in reverse mode alone: use backward() in place of jvp"
        )
