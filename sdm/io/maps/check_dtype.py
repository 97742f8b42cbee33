"""Values of images as float32."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdm.core.axis_order import reversed_axes
from sdm.errors import FormatError


def plain_numbers(values: np.ndarray, path: Path) -> np.ndarray:
    """An image's values as contiguous float32 that may be written to.

    Raises:
        FormatError: They are colours or complex numbers, of which a part would be lost.
    """
    if values.dtype.kind not in "buif":
        raise FormatError(f"{path} has values of type {values.dtype}: plain numbers are needed")
    if values.ndim == 3 and values.flags.f_contiguous and not values.flags.c_contiguous:
        values = reversed_axes(values.T)
    return np.require(values, np.float32, ["C_CONTIGUOUS", "WRITEABLE"])
