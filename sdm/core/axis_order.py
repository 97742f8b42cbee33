"""Volumes with their axes in reverse: maps have z along memory, files of images have x. It imports little."""

from __future__ import annotations

import numpy as np

# A piece of so many values is small enough for a core's own cache, of a line of at most so many.
PIECE, LINE = 1 << 16, 256
# Values between its lines. Volumes often measure a power of two, and then lines below each other share few places of a
# cache: NumPy alone takes four to six times as long for 128^3 and 256^3.
APART = 4


def reversed_axes(values: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """Copy of a volume (nx,ny,nz) as (nz,ny,nx), contiguous, or in `out` of that shape."""
    if out is None:
        out = np.empty(values.shape[::-1], values.dtype)
    nx, ny, nz = values.shape
    line = min(nx, LINE)
    rows = max(1, min(ny, PIECE // max(1, line * nz)))
    room = np.empty((line, rows, nz + APART), values.dtype)
    for i in range(0, nx, LINE):
        for j in range(0, ny, rows):
            part = values[i : i + LINE, j : j + rows]
            piece = room[: part.shape[0], : part.shape[1], :nz]
            piece[:] = part
            out[:, j : j + rows, i : i + LINE] = piece.T
    return out
