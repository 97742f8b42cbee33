"""Edges of two faces that run along them in opposite directions, by NumPy alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int32


def every_edge_is_paired(faces: Int32[np.ndarray, "F 3"]) -> bool:
    """True if each edge of faces (F,3) belongs to two of them, once in each direction: then the mesh has no boundary.

    False says nothing: faces may also meet at edges of four faces, or at equal positions of other vertices.
    """
    begin = faces.T.astype(np.int64)
    end = begin[[1, 2, 0]]
    # Both directions of an edge have keys that differ by one.
    keys = ((np.minimum(begin, end) << 32 | np.maximum(begin, end)) << 1 | (begin > end)).ravel()
    if len(keys) % 2:
        return False
    keys.sort()
    there, back = keys[::2], keys[1::2]
    return bool((back - there == 1).all() and not (there & 1).any() and (there[1:] > back[:-1]).all())
