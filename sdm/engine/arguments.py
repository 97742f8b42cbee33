"""Arguments of the public calls: orientation, signs, names of grids in errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypedDict, get_args

import torch
from torch import Tensor

from sdm.core.given_values import real
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.orient import orient_faces
from sdm.errors import MeshError, SDMError
from sdm.inspect import orient_outward

Orient = Literal["keep", "auto", "parts"]
Sign = Literal["winding", "flood", "none"]
ORIENTS, SIGNS = get_args(Orient), get_args(Sign)

# Voxels that a gap is wide which a flood just passes, if nobody says otherwise.
DEFAULT_HOLE = 2.0


# Options as keyword types, which the overloads of each call share.
class SignOptions(TypedDict, total=False):
    """Signs of maps."""

    sign: Sign
    hole_size: float | None


class ComparedSignOptions(SignOptions, total=False):
    """Signs of maps, and whether two ways to them are compared."""

    compare_signs: bool


class MapOptions(ComparedSignOptions, total=False):
    """Grid, device and signs of one map."""

    resolution: int | None
    margin: float | None
    device: str | torch.device | None
    orient: Orient


class ListOptions(MapOptions, total=False):
    """The same of maps of many meshes, and their memory."""

    max_bytes: int | None


class BatchOptions(SignOptions, total=False):
    """Grid, device and signs of a batch that shares its faces."""

    resolution: int | None
    margin: float | None
    device: str | torch.device | None


class PointOptions(TypedDict, total=False):
    """Device and signs of points."""

    device: str | torch.device | None
    sign: Sign


class PointListOptions(PointOptions, total=False):
    """The same of points of many meshes, and their memory."""

    max_bytes: int | None


@dataclass(frozen=True)
class SignMethod:
    """A method by which maps are signed.

    Args:
        sign: Its name.
        hole_size: Of a flood, the length of the narrowest gaps that it may pass; None for two voxels.
        compare: Also count the voxels on which winding numbers and a flood disagree.

    Raises:
        SDMError: Another name, a length that makes no sense, or one for a method that takes none.
    """

    sign: Sign = "winding"
    hole_size: float | None = None
    compare: bool = False

    def __post_init__(self) -> None:
        if self.sign not in SIGNS:
            raise SDMError(f"sign is {self.sign!r}; use 'winding', 'flood' or 'none'")
        if self.hole_size is None:
            return
        if self.sign != "flood" and not self.compare:
            raise SDMError(f"hole_size is the width of gaps for sign='flood'; with sign={self.sign!r} it says nothing")
        size = real(self.hole_size)
        if not 0 <= size < math.inf:
            raise SDMError(f"hole_size is {self.hole_size!r}; give a length of at least 0, in the mesh's unit")
        object.__setattr__(self, "hole_size", size)

    @property
    def is_default(self) -> bool:
        """True if winding numbers alone are wanted."""
        return self.sign == "winding" and not self.compare

    @property
    def needs_winding(self) -> bool:
        """True if winding numbers are looked at."""
        return self.sign == "winding" or self.compare

    def field(
        self, grid: Grid, distances: Tensor, winding: SDM | None, flood: Callable[[Tensor, float], Tensor]
    ) -> SDM:
        """The map by this method.

        Args:
            grid: Where.
            distances: (nx,ny,nz), without a sign.
            winding: The map by winding numbers, if they are needed.
            flood: What gives distances the sign of a flood, for a width of gaps.
        """
        if self.is_default and winding is not None:
            return winding
        if self.sign == "none" and not self.compare:
            return SDM(distances, grid, sign="none")
        hole = self.hole_on(grid)
        flooded = flood(distances, hole)
        differ = None
        if winding is not None and self.compare:
            differ = int(((winding.values < 0) != (flooded < 0)).sum())
        if self.sign == "flood":
            return SDM(flooded, grid, sign="flood", hole_size=hole, sign_disagreements=differ)
        if self.sign == "winding" and winding is not None:
            return SDM(winding.values, grid, winding.ambiguous_voxels, sign="winding", sign_disagreements=differ)
        return SDM(distances, grid, sign="none", sign_disagreements=differ)

    def hole_on(self, grid: Grid) -> float:
        """The width of gaps on a grid: what was given, or two of its longest voxel edges."""
        return DEFAULT_HOLE * max(grid.spacing) if self.hole_size is None else self.hole_size


WINDING, UNSIGNED = SignMethod(), SignMethod("none")


def check_orient(orient: str) -> None:
    """Refuse another way to turn faces than there is.

    Raises:
        MeshError: It is one.
    """
    if orient not in ORIENTS:
        raise MeshError(f"orient is {orient!r}; use 'keep', 'auto' or 'parts'")


def oriented(mesh: TriangleMesh, orient: Orient, device: torch.device) -> TriangleMesh:
    """The mesh, turned outward if that is wanted; what that takes is done on a device."""
    if orient == "keep":
        return mesh
    check_orient(orient)
    return orient_faces(mesh, device) if orient == "parts" else orient_outward(mesh)


def described(grid: Grid) -> str:
    """A map of this grid, as errors name it."""
    return f"a map of {' x '.join(map(str, grid.shape))} voxels"
