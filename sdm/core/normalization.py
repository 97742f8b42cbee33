"""Normalisation of a mesh: what takes it to a standard place and size, kept with its inverse."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError, SDMError

Normal = Literal["sphere", "cube"]
# Room between a shape and its sphere, as in DeepSDF's preprocessing.
BUFFER = 1.03


@dataclass(frozen=True)
class Normalization:
    """A shift and a scale: a point p of the mesh's own coordinates becomes (p - centre) / length.

    Args:
        kind: "sphere": the vertex furthest from the middle of the mesh's box comes to be 1/1.03 from the origin, as in
            DeepSDF. "cube": the mesh's box comes to lie about the origin with its longest edge from -1 to 1.
        centre: (x,y,z) in the mesh's unit.
        length: In the mesh's unit, positive; a distance in the normalised unit times it is one in the mesh's.

    Raises:
        SDMError: Another kind.
        MeshError: A length that is not positive, or a number that is not finite.
    """

    kind: Normal
    centre: tuple[float, float, float]
    length: float

    def __post_init__(self) -> None:
        if self.kind not in get_args(Normal):
            raise SDMError(f"a normalisation of kind {self.kind!r} is not known; use {' or '.join(get_args(Normal))}")
        if len(self.centre) != 3 or not all(map(math.isfinite, (*self.centre, self.length))) or self.length <= 0:
            raise MeshError(f"the mesh cannot be normalised: its {self.kind} has the size {self.length:g}")

    @classmethod
    def of(cls, mesh: TriangleMesh, kind: Normal) -> Normalization:
        """The normalisation of a mesh, by the vertices that its faces use."""
        at = mesh.vertices.detach()[mesh.faces.reshape(-1).long()].double().cpu().numpy()
        low, high = at.min(0), at.max(0)
        middle = (low + high) / 2
        length = (
            BUFFER * float(np.linalg.norm(at - middle, axis=1).max())
            if kind == "sphere"
            else float((high - low).max()) / 2
        )
        x, y, z = middle.tolist()
        return cls(kind, (x, y, z), length)

    def normalised(self, mesh: TriangleMesh) -> TriangleMesh:
        """The mesh with normalised vertices, computed in float64 and rounded to float32."""
        at = (mesh.vertices.double() - self._centre(mesh.vertices)) / self.length
        return TriangleMesh(at.float(), mesh.faces, mesh.name, check=False)

    def restored(self, mesh: TriangleMesh) -> TriangleMesh:
        """The inverse of `normalised`, for example of a surface of the map."""
        at = mesh.vertices.double() * self.length + self._centre(mesh.vertices)
        return TriangleMesh(at.float(), mesh.faces, mesh.name, check=False)

    def __str__(self) -> str:
        """In words: the kind, the centre and the length, to the last bit."""
        return " ".join([self.kind, *map(repr, (*self.centre, self.length))])

    @classmethod
    def parse(cls, text: str) -> Normalization:
        """The inverse of `str`."""
        kind, *numbers = text.split()
        x, y, z, length = map(float, numbers)
        return cls(kind, (x, y, z), length)  # pyright: ignore[reportArgumentType]

    def _centre(self, like: Tensor) -> Tensor:
        return torch.tensor(self.centre, dtype=torch.float64, device=like.device)
