"""Lines of numbers, as text meshes consist of."""

from __future__ import annotations

import codecs
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np


def as_bytes(data: bytes) -> bytes:
    """Text in an encoding that has every character of a number as one byte, whatever its other characters are.

    So are ASCII, UTF-8 and every Latin one; UTF-16, which a mark at the begin tells, is not.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


@dataclass(frozen=True)
class TextRows:
    """The numbers of lines, one line after the other.

    Args:
        values: (N,) float64: all of them.
        starts: (L,) int64: the first of each line.
        lengths: (L,) int64: how many each line has.
    """

    values: np.ndarray
    starts: np.ndarray
    lengths: np.ndarray

    def columns(self, count: int) -> np.ndarray:
        """The first `count` numbers of every line, (L,count); no line may have fewer."""
        return self.values[self.starts[:, None] + np.arange(count)]


def parse_rows(lines: Sequence[bytes]) -> TextRows:
    """Numbers of lines of text, separated by white space.

    Raises:
        ValueError: Something there is no number.
    """
    lengths = np.fromiter((len(line.split()) for line in lines), np.int64, len(lines))
    values = parse_numbers(b"\n".join(lines), int(lengths.sum()))
    return TextRows(values, np.cumsum(lengths) - lengths, lengths)


def parse_numbers(text: bytes, count: int) -> np.ndarray:
    """The `count` numbers (count,) float64 of a text.

    Raises:
        ValueError: Something there is no number.
    """
    if count == 0:
        return np.zeros(0)
    # NumPy says of what is no number, as an error or as a deprecation, only that it is there.
    with warnings.catch_warnings(), suppress(ValueError):
        warnings.simplefilter("ignore")
        values = np.fromstring(text, dtype=np.float64, sep=" ")
        if len(values) == count:
            return values
    wrong = next((word for word in text.split() if not _is_number(word)), b"")
    raise ValueError(f"{wrong[:40].decode('latin-1')!r} is no number")


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word


def as_integers(values: np.ndarray) -> np.ndarray:
    """Whole numbers as int64.

    Raises:
        ValueError: One is not whole.
    """
    if values.dtype.kind == "f":
        wrong = ~(np.abs(values) < 2.0**53) | (values != np.rint(values))
        if wrong.any():
            raise ValueError(f"{values[wrong][0]} is no whole number")
    return values.astype(np.int64)


def ragged_index(starts: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Indices (sum of lengths,) of runs of `lengths` (R,) entries that begin at `starts` (R,)."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(starts - before, lengths) + np.arange(int(lengths.sum()))
