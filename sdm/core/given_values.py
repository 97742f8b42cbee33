"""Values that callers give, of whatever type: numbers, whole numbers, paths."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdm.errors import FormatError, SDMError

# Whole numbers of kernels and of NumPy end here.
_END = 2**63


def real(value: Any) -> float:
    """The number that a value is, and NaN of what is none, which every check of a range refuses too.

    Text is none, also where it is digits.
    """
    if isinstance(value, str | bytes):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        return math.nan


def whole(value: Any, least: int) -> int | None:
    """The whole number from `least` on and below 2^63 that a value is, such as 3 or 3.0; None of what is none."""
    try:
        found = operator.index(value)
    except TypeError:
        number = real(value)
        if not number.is_integer():
            return None
        found = int(number)
    return found if least <= found < _END else None


def two_numbers(values: Any) -> tuple[float, float]:
    """The two numbers of a range, and NaNs of what is none."""
    if not isinstance(values, Sequence) or len(values) != 2:
        return math.nan, math.nan
    return real(values[0]), real(values[1])


def as_path(path: Any, error: type[SDMError] = FormatError) -> Path:
    """A path that was given as text or as what has one.

    Raises:
        SDMError: It is none, as the class `error`.
    """
    try:
        found = Path(path)
    except TypeError:
        raise error(
            f"an object of type {type(path).__name__} is no path: give a text, such as 'bunny.ply', or a pathlib.Path"
        ) from None
    if "\0" in str(found):
        raise error(f"the path {str(found)!r} has a null character, which no name of a file has: leave it out")
    return found


def as_level(level: Any) -> float:
    """The distance at which a surface of a map is wanted.

    Raises:
        SDMError: It is no number.
    """
    found = real(level)
    if math.isnan(found):
        raise SDMError(f"the level is {level!r}; give a distance in the mesh's unit, 0 for the surface itself")
    return found
