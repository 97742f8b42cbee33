"""libigl: `signed_distance`. Negative inside, float64, int64 faces."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch

from sdm.compat.closest_in_float64 import ClosestInFloat64


def signed_distance(
    P: Any,  # noqa: N803
    V: Any,  # noqa: N803
    F: Any,  # noqa: N803
    sign_type: Any = None,
    lower_bound: float = -math.inf,
    upper_bound: float = math.inf,
    *,
    device: str | torch.device | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`igl.signed_distance` of libigl's Python bindings since 2.6.

    Args:
        P: (N,3) points.
        V: (V,3) vertices.
        F: (F,3) faces.
        sign_type: One of libigl's, or its name. Unsigned distances where it is that; of all others inside is where the
            winding number is above 0.5.
        lower_bound: Of the distances that are wanted, as libigl understands it: both bounds finite, the unsigned ones
            below the larger of their absolute values, and above that less their difference. Others are NaN.
        upper_bound: See there.
        device: Where to compute; by default a GPU if there is one.

    What was built for a mesh is kept until another one comes: further calls with the same values do not build it again.

    Returns:
        S (N,) distances float64, negative inside; I (N,) faces int64; C (N,3) closest points; N (N,3) normals of those
        faces, or (0,3) but for the sign type "pseudonormal". Where S is NaN the face is F's length + 1, and the closest
        point 0, as in libigl.
    """
    distance, closest, face, normal = _index(V, F, device).query(P)
    kind = str(getattr(sign_type, "name", sign_type)).lower()
    if "unsigned" in kind:
        distance = np.abs(distance)
    unwanted = _beyond(np.abs(distance), lower_bound, upper_bound)
    distance[unwanted], face[unwanted], closest[unwanted] = np.nan, len(F) + 1, 0.0
    return distance, face, closest, normal if "pseudonormal" in kind else np.zeros((0, 3))


class _Last(NamedTuple):
    """The mesh of the last call, copied, as callers may write into their arrays."""

    vertices: np.ndarray
    faces: np.ndarray
    device: str | torch.device | None
    index: ClosestInFloat64


_last: _Last | None = None


def _index(vertices: Any, faces: Any, device: str | torch.device | None) -> ClosestInFloat64:
    global _last  # noqa: PLW0603
    last, corners, triples = _last, np.asarray(vertices), np.asarray(faces)
    if (
        last is not None
        and last.device == device
        and np.array_equal(last.vertices, corners)
        and np.array_equal(last.faces, triples)
    ):
        return last.index
    index = ClosestInFloat64(vertices, faces, device)
    _last = _Last(corners.copy(), triples.copy(), device, index)
    return index


def forget() -> None:
    """Let go of the mesh that the last call kept."""
    global _last  # noqa: PLW0603
    _last = None


def _beyond(distance: np.ndarray, lower: float, upper: float) -> np.ndarray:
    most = max(abs(lower), abs(upper))
    if math.isinf(most):
        return np.zeros(len(distance), bool)
    least = max(most - (upper - lower), 0.0)
    return (distance >= most) | (distance <= least)
