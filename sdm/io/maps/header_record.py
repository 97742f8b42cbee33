"""The geometry of an image whose header has a record of ours, which may have been moved by another program."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sdm.core.grid import Grid
from sdm.io.maps.record import from_record


def geometry_of(kept: Any, affine: np.ndarray, shape: tuple[int, ...], path: Path) -> tuple[Grid, int | None, Any]:
    """Grid, count of ambiguous voxels, and the record `kept` that both are from.

    The count and the record are None where the header, `affine` and `shape`, tells another place: the image was moved.

    Raises:
        FormatError: The record is damaged, or no record of a map.
    """
    if kept is not None:
        exact = from_record(kept, str(path))
        scale = np.abs(exact[0].affine[:3, :3]).max()
        if exact[0].shape == shape and np.allclose(exact[0].affine, affine, rtol=1e-12, atol=1e-9 * scale):
            return *exact, kept
    return Grid.from_affine(affine, shape), None, None
