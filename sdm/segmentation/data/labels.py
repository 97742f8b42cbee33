"""Foreground of a label."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdm.errors import FormatError

# Scaled integers come back a little beside whole numbers.
ROUNDING = 1e-3


def foreground(values: np.ndarray, path: Path) -> NDArray[np.bool_]:
    """Mask of the voxels whose number in a label is not 0.

    Raises:
        FormatError: The values are no numbers, not finite, or not whole: probabilities, or an image.
    """
    if values.dtype.kind in "bui":
        return values != 0
    if values.dtype.kind != "f":
        raise FormatError(f"{path} holds values of type {values.dtype}: a label of numbers is needed")
    if not np.isfinite(values).all():
        raise FormatError(f"{path} has values that are not finite: a label has 0 for the background")
    whole = np.round(values)
    beside = np.abs(values - whole)
    if beside.size and beside.max() > ROUNDING:
        value = values.flat[int(beside.argmax())]
        raise FormatError(f"{path} is no label, for it has values such as {value:.4g}: threshold probabilities first")
    return whole != 0
