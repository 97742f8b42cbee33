"""Foreground and classes of a label."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from sdm.errors import FormatError

# More values than any atlas has: an image, or a map.
MOST_CLASSES = 2000
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


def class_numbers(values: np.ndarray, path: Path) -> NDArray[np.integer]:
    """The whole number of each voxel of a label, 0 for the background, int32 (int64 where one is larger).

    Raises:
        FormatError: As by `foreground`.
    """
    foreground(values, path)
    whole = np.round(values) if values.dtype.kind == "f" else values
    large = whole.size > 0 and max(float(whole.max()), -float(whole.min())) >= 2**31
    return whole.astype(np.int64 if large else np.int32)


def classes_of(label: Tensor, path: Path) -> tuple[int, ...]:
    """The numbers in a label but 0, in order.

    Raises:
        FormatError: There are more than `MOST_CLASSES`.
    """
    found = tuple(value for value in label.unique().tolist() if value != 0)
    if len(found) > MOST_CLASSES:
        raise FormatError(f"{path} has {len(found):,} different values, so it is no label: give one of labels")
    return found
