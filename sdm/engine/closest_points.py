"""Closest points: the result of a query beside its distances."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float32, Int32
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Closest:
    """Closest points of a query: their places, faces and barycentric coordinates.

    Args:
        points: (N,3) float32, in the mesh's unit.
        faces: (N,) int32, the face that each lies on; -1 for a query point that is not finite. Of the faces that meet
            in a closest point on an edge or a corner it is the one whose plane faces the query point most (the largest
            |cos| of the angle between its normal and the way there), and of those that do so alike, to within 1e-6,
            the one with the smallest number. So at an edge of two faces its normal tells the side, however acute.
        barycentric: (N,3) float32, its barycentric coordinates on that face.
    """

    points: Float32[Tensor, "*n 3"]
    faces: Int32[Tensor, "*n"]
    barycentric: Float32[Tensor, "*n 3"]
