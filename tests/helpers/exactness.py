"""The definition of "exact", for every test that compares with the brute force.

The distance may be wrong by four float32 roundings of the largest coordinate of mesh and point. The sign must be
right wherever the winding number is further than 1e-3 from 0.5 and the distance is above that limit.
"""

from __future__ import annotations

import hashlib

import numpy as np
import torch

from tests.helpers import oracle

ROUNDING = 2.0**-24
SMALLEST = 2.0**-126  # numbers below this one are rounded as it is
SURE = 1e-3
# Comparisons that several tests make, of one mesh at the same points: the brute force is slow.
MOST_KEPT = 500
_kept: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}


def brute_force(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances and winding numbers (N,) float64 by `oracle`, kept for the next test that asks for the same."""
    digest = hashlib.blake2b(digest_size=16)
    for array in (vertices, faces, points):
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    key = digest.digest()
    if key not in _kept:
        if len(_kept) >= MOST_KEPT:
            del _kept[next(iter(_kept))]
        _kept[key] = oracle.distance(vertices, faces, points)[0], oracle.winding_number(vertices, faces, points)
    return _kept[key]


def scale_of(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Largest coordinate of the mesh and of each point: (N,) float64."""
    largest = max(np.abs(np.asarray(vertices, np.float64)[faces]).max(), SMALLEST)
    return np.maximum(largest, np.abs(np.asarray(points, np.float64)).max(1, initial=0.0))


def assert_exact(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, values: torch.Tensor) -> None:
    """Check signed distances `values` (N,) at `points` (N,3) against the brute force."""
    found = values.detach().cpu().numpy().astype(np.float64).reshape(-1)
    points = np.asarray(points, np.float32).reshape(-1, 3)
    limit = 4 * ROUNDING * scale_of(vertices, faces, points)
    expected, winding = brute_force(np.asarray(vertices), np.asarray(faces), points)
    error = np.abs(np.abs(found) - expected)
    worst = int(np.nanargmax(np.where(np.isnan(error), np.inf, error / limit)))
    assert error[worst] <= limit[worst], (
        f"distance at {points[worst].tolist()} is {found[worst]!r}, not {expected[worst]!r}: "
        f"{4 * error[worst] / limit[worst]:.1f} roundings off"
    )
    sure = (np.abs(winding - 0.5) > SURE) & (expected > limit)
    wrong = sure & ((found < 0) != (winding > 0.5))
    assert not wrong.any(), (
        f"{wrong.sum()} wrong signs, the first at {points[wrong][0].tolist()}: "
        f"value {found[wrong][0]!r}, winding number {winding[wrong][0]!r}"
    )


def assert_winding(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, winding: torch.Tensor) -> None:
    """Check winding numbers of a mesh with few boundary edges, off the surface: one lattice step moves the boundary."""
    points = np.asarray(points, np.float32).reshape(-1, 3)
    far, expected = brute_force(np.asarray(vertices), np.asarray(faces), points)
    scale = scale_of(vertices, faces, points)
    off = far > 4 * ROUNDING * scale
    error = np.abs(winding.cpu().numpy() - expected)[off]
    limit = 1e-6 * np.maximum(1, np.abs(expected[off])) + 2.0**-28 * scale[off] / far[off]
    assert (error <= limit).all(), f"winding number off by {error.max()}, at {points[off][error.argmax()].tolist()}"
