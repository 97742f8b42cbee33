"""Vertices at exactly equal positions."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Int64, Shaped


def first_at_position(vertices: Float32[np.ndarray, "V 3"]) -> Int64[np.ndarray, " V"]:
    """For each vertex (V,3) float32 the index of the first one at exactly its position: (V,) int64. -0 equals +0."""
    x, y, z = ((vertices + np.float32(0)).astype(np.float32).view(np.uint32).T).astype(np.uint64)
    _, group = first_and_group((x << np.uint64(32)) | y)
    first, group = first_and_group((group.astype(np.uint64) << np.uint64(32)) | z)
    return first[group]


def first_and_group(keys: Shaped[np.ndarray, " n"]) -> tuple[Int64[np.ndarray, " g"], Int64[np.ndarray, " n"]]:
    """Number equal keys (n,) alike: the first index of each group (g,) and the group of each key (n,), both int64."""
    order = np.argsort(keys)
    starts, group_of_sorted = runs(keys[order])
    group = np.empty(len(keys), dtype=np.int64)
    group[order] = group_of_sorted
    return np.minimum.reduceat(order, starts), group


def runs(ordered: Shaped[np.ndarray, " n"]) -> tuple[Int64[np.ndarray, " g"], Int64[np.ndarray, " n"]]:
    """Runs of equal values in a sorted array (n,): the start of each (g,), and the run of each value (n,)."""
    new = np.empty(len(ordered), dtype=bool)
    new[:1] = True
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:])
    return np.flatnonzero(new), np.cumsum(new) - 1
