"""The flood of `sdm.kernels.flood` in NumPy and SciPy: every voxel, every neighbour, no short cuts."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

STEPS = [step for step in product((-1, 0, 1), repeat=3) if step != (0, 0, 0)]


def inside(
    distances: np.ndarray,
    near: np.ndarray,
    spacing: tuple[float, float, float],
    beyond: np.ndarray,
    radius: float,
    slack: float,
    centres: np.ndarray,
    closest: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Marks of the voxels (nx,ny,nz) that a flood calls inside, where they are off the surface.

    Args:
        distances: (nx,ny,nz) to the mesh, unsigned.
        near: The same to the mesh and what closes its small holes.
        spacing: Of the voxels.
        beyond: (nx,ny,nz) marks of the voxels beyond the mesh's box.
        radius: Of the ball.
        slack: Rounding of distances.
        centres: (nx,ny,nz,3).
        closest: The point of the mesh and its caps closest to a point.
    """
    reached = _reached(distances.astype(np.float64), spacing, beyond, radius, slack)
    shape, near = near.shape, near.astype(np.float64)
    links = np.full(shape, -1)
    best = np.full(shape, 1e-3)
    numbers = np.arange(near.size).reshape(shape)
    for step in STEPS:
        length = np.linalg.norm(np.multiply(step, spacing))
        here, there = _pair(shape, step)
        rise = np.full(shape, -np.inf)
        free = near[here] + near[there] > length + slack
        rise[here] = np.where(free, (near[there] - near[here]) / length, -np.inf)
        other = np.zeros(shape, int)
        other[here] = numbers[there]
        better = rise > best
        links[better], best[better] = other[better], rise[better]
    links[reached] = numbers[reached]
    reached, flat, links = reached.reshape(-1), near.reshape(-1), links.reshape(-1)
    points = centres.reshape(-1, 3).astype(np.float64)
    for at in np.flatnonzero(links < 0):
        links[at] = _climb(int(at), points, shape, spacing, flat, reached, slack, closest)
    order = np.argsort(-flat)
    outside = reached.copy()
    # Links lead to larger distances, or to what was reached.
    for at in order:
        outside[at] |= outside[links[at]]
    return ~outside.reshape(shape)


def _reached(d: np.ndarray, spacing: tuple, beyond: np.ndarray, radius: float, slack: float) -> np.ndarray:
    numbers = np.arange(d.size).reshape(d.shape)
    one, other = [numbers[beyond]], [np.full(beyond.sum(), numbers[beyond][0])]
    for step in STEPS[13:]:
        length = np.linalg.norm(np.multiply(step, spacing))
        here, there = _pair(d.shape, step)
        a, b = d[here], d[there]
        foot = np.clip((a**2 - b**2 + length**2) / (2 * length), 0, length)
        height2 = np.where(foot >= length, b**2, a**2 - foot**2)
        passes = (a + b > length + slack) & (height2 >= radius**2)
        one.append(numbers[here][passes])
        other.append(numbers[there][passes])
    pairs = np.concatenate(one), np.concatenate(other)
    labels = connected_components(coo_matrix((np.ones(len(pairs[0])), pairs), shape=(d.size, d.size)), False)[1]
    return (labels == labels[numbers[beyond][0]]).reshape(d.shape)


def _pair(shape: tuple[int, ...], step: tuple[int, ...]) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    here = tuple(slice(max(0, -s), n - max(0, s)) for s, n in zip(step, shape, strict=True))
    there = tuple(slice(max(0, s), n - max(0, -s)) for s, n in zip(step, shape, strict=True))
    return here, there


def _climb(
    at: int,
    points: np.ndarray,
    shape: tuple[int, ...],
    spacing: tuple,
    near: np.ndarray,
    reached: np.ndarray,
    slack: float,
    closest: Callable[[np.ndarray], np.ndarray],
) -> int:
    p = points[at]
    away = p - closest(p)
    distance = float(np.linalg.norm(away))
    if distance <= slack:
        return at
    direction, step = away / distance, max(distance, 0.5 * min(spacing))
    for _ in range(128):
        rise = np.linalg.norm(direction)
        if rise < 0.02 or step < 0.02 * distance:
            return at
        there = (p + step / rise * direction).astype(np.float32).astype(np.float64)
        away = there - closest(there)
        found = float(np.linalg.norm(away))
        if distance + found <= np.linalg.norm(there - p) * (1 + 1e-12):
            step /= 2
        elif found >= distance + 0.5 * rise * step:
            p, distance, direction, step = there, found, away / found, min(2 * step, 2 * max(spacing))
            index = np.floor((p - points[0]) / spacing + 0.5).astype(int)
            if ((index >= 0) & (index < shape)).all():
                other = int(np.ravel_multi_index(tuple(index), shape))
                seen = np.linalg.norm(p - points[other]) + slack < distance
                if seen and (reached[other] or near[other] > near[at] + slack):
                    return other
        else:
            new = (p - there + away) / np.linalg.norm(p - there + away)
            change = direction - new
            if direction @ change > 0.1 * rise * rise:
                direction = direction - min(direction @ change / (change @ change), 1.0) * change
            else:
                step /= 2
    return at
