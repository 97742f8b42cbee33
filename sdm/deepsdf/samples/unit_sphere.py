"""The normalisation of a shape into the unit sphere, kept with its inverse."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError

# Room between the shape and the sphere, as in DeepSDF's preprocessing.
BUFFER = 1.03


@dataclass(frozen=True)
class UnitSphere:
    """A sphere in a mesh's unit that becomes the unit sphere around the origin.

    Args:
        centre: (x,y,z) in the mesh's unit.
        radius: In the mesh's unit, positive.

    Points go through `to_unit` and `from_unit`; a distance in the unit sphere times `radius` is one in the mesh's unit.

    Raises:
        MeshError: A radius that is not positive, or a number that is not finite.
    """

    centre: tuple[float, float, float]
    radius: float

    def __post_init__(self) -> None:
        if len(self.centre) != 3 or not all(map(math.isfinite, (*self.centre, self.radius))) or self.radius <= 0:
            raise MeshError(
                f"a sphere with centre {self.centre} and radius {self.radius} cannot normalise a shape; "
                "give three finite coordinates and a positive radius"
            )

    @classmethod
    def of(cls, points: TriangleMesh | Any) -> UnitSphere:
        """The sphere around a mesh, or around points (N,3): at the middle of their box, with 3 % of room."""
        if isinstance(points, TriangleMesh):
            points = points.vertices.detach()[points.faces.reshape(-1).long()]
        at = torch.as_tensor(points, device="cpu").detach().double()
        middle = (at.amin(0) + at.amax(0)) / 2
        radius = BUFFER * float((at - middle).norm(dim=1).max())
        x, y, z = middle.tolist()
        return cls((x, y, z), radius)

    def to_unit(self, points: Tensor) -> Tensor:
        """Points (...,3) in the mesh's unit, normalised; computed in float64, float32 on the points' device."""
        return ((points.double() - self._middle(points)) / self.radius).float()

    def from_unit(self, points: Tensor) -> Tensor:
        """The inverse of `to_unit`."""
        return (points.double() * self.radius + self._middle(points)).float()

    def normalised(self, mesh: TriangleMesh) -> TriangleMesh:
        """The mesh with normalised vertices."""
        return TriangleMesh(self.to_unit(mesh.vertices), mesh.faces, mesh.name, check=False)

    def _middle(self, points: Tensor) -> Tensor:
        return torch.tensor(self.centre, dtype=torch.float64, device=points.device)
