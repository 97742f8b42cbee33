"""Faces with the same three positions."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int64

from sdm.inspect.positions import first_and_group


def first_copies(
    merged: Int64[np.ndarray, "F 3"], vertices: int
) -> tuple[Int64[np.ndarray, " F"], Bool[np.ndarray, " F"]]:
    """The first face with the same vertices as each, in any order, and whether both face the same way.

    Args:
        merged: (F,3) vertex indices below `vertices` that tell positions apart.
        vertices: More than the largest.

    Returns:
        (F,) index of a face, its own if there is none before it; (F,) True also for faces without a side, which use a
        vertex twice.
    """
    a, b, c = np.sort(merged, axis=1).T
    _, pair = first_and_group(a * vertices + b)
    first, group = first_and_group(pair * vertices + c)
    x, y, z = merged.T
    # Around a triangle numbers rise twice and fall once, or the other way round if it is turned.
    up = (x < y).astype(np.int8) + (y < z) + (z < x) == 2
    first = first[group]
    return first, (up == up[first]) | (a == b) | (b == c)
