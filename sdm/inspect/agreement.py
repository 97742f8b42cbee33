"""Agreement of faces about which side is out, over the edges that two of them share."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64, Integer

from sdm.inspect.edges import label


def agreeing_turns(
    merged: Int64[np.ndarray, "F 3"], area: Float64[np.ndarray, " F"]
) -> tuple[Bool[np.ndarray, " F"], Integer[np.ndarray, " F"], int]:
    """The faces to turn so that each patch agrees with itself, and the patches.

    Args:
        merged: (F,3) vertex indices that tell positions apart.
        area: (F,) area of each face.

    Returns:
        (F,) the faces to turn, the smaller part of each patch by area; (F,) the patch of each face; how many there are.

    A patch is what edges of exactly two faces hold together. Two faces agree if they traverse their edge in opposite
    directions. Every face has two nodes in a graph, as it is and turned, and edges connect what agrees: in a patch that
    can be made to agree the nodes fall into two mirrored halves; in a one-sided one (a Moebius strip) they do not, and
    it is left alone.
    """
    count = len(merged)
    one, other, agree = _pairs(merged)
    halves = label(
        np.concatenate([one, one + count]), np.concatenate([other + count * ~agree, other + count * agree]), 2 * count
    )
    as_it_is, turned = halves[:count], halves[count:]
    names, patch = np.unique(np.minimum(as_it_is, turned), return_inverse=True)
    turn = turned < as_it_is
    weight = np.bincount(patch, area, minlength=len(names))
    turn ^= (np.bincount(patch, area * turn, minlength=len(names)) > weight / 2)[patch]
    return turn & (as_it_is != turned), patch, len(names)


def _pairs(merged: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The two faces of each edge that has exactly two, and whether they agree."""
    following = np.roll(merged, -1, 1)
    proper = np.flatnonzero((merged != following).all(1))
    start, end, face = merged[proper].reshape(-1), following[proper].reshape(-1), np.repeat(proper, 3)
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.argsort(low * (int(merged.max(initial=0)) + 1) + high, kind="stable")
    low, high, up, face = low[order], high[order], (start < end)[order], face[order]
    new = np.ones(len(low) + 1, dtype=bool)
    new[1:-1] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    begin = np.flatnonzero(new)
    first = begin[:-1][np.diff(begin) == 2]
    return face[first], face[first + 1], up[first] != up[first + 1]
