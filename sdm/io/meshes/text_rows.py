"""Lines of numbers, as text meshes consist of."""

from __future__ import annotations

import codecs
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Bytes of a text that it is worth starting Warp for, and those that a kernel cannot count.
LARGE, LARGEST = 1 << 22, (1 << 31) - 2


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

    @classmethod
    def of_table(cls, table: np.ndarray) -> TextRows:
        """The rows (L,C) of lines that have as many numbers each."""
        rows, columns = table.shape
        return cls(table.reshape(-1), columns * np.arange(rows), np.full(rows, columns))

    def columns(self, count: int) -> np.ndarray:
        """The first `count` numbers of every line, (L,count); no line may have fewer."""
        table = self._table()
        return table[:, :count] if table is not None else self.values[self.starts[:, None] + np.arange(count)]

    def runs(self, first: int, lengths: np.ndarray) -> np.ndarray:
        """Of each line the `lengths` (L,) numbers from its `first` on, one line after the other."""
        table = self._table()
        if table is not None and len(lengths) and (lengths == lengths[0]).all():
            return table[:, first : first + int(lengths[0])].ravel()
        return self.values[ragged_index(self.starts + first, lengths)]

    def _table(self) -> np.ndarray | None:
        """The numbers of lines that have as many each, (L,C)."""
        if not len(self.lengths) or (self.lengths != self.lengths[0]).any():
            return None
        return self.values.reshape(len(self.lengths), -1)


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


class ScannedLines:
    """Lines of a large text, of which any may be parsed by a kernel, in a fifth of the time.

    Args:
        text: Its lines end with line feeds.
        obj: True for an OBJ file, of whose lines the kinds are told by their keywords.
    """

    def __init__(self, text: bytes, *, obj: bool = False) -> None:
        self._text, self._obj = np.frombuffer(text, np.uint8), obj
        ends = np.flatnonzero(self._text == ord("\n"))
        self._starts = np.concatenate([[0], ends + 1, [len(text)]]).astype(np.int32)

    @cached_property
    def _scanned(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Kinds, first places and counts of words of the lines."""
        from sdm.kernels.text.number_rows import scan_lines

        return scan_lines(self._text, self._starts, obj=self._obj)

    @classmethod
    def of(cls, text: bytes, *, obj: bool = False) -> ScannedLines | None:
        """The lines, if the text is large enough to start Warp for it, or Warp has started, and not too large."""
        if len(text) >= LARGEST or (len(text) < LARGE and "warp" not in sys.modules):
            return None
        return cls(text, obj=obj)

    def not_blank(self) -> np.ndarray:
        """Numbers (L,) of the lines that have something on them."""
        return np.flatnonzero(self._scanned[2] > 0)

    def of_kind(self, kind: int) -> np.ndarray:
        """Numbers (L,) of the lines of an OBJ file of a kind."""
        return np.flatnonzero(self._scanned[0] == kind)

    def rows(self, lines: np.ndarray, *, faces: bool = False) -> TextRows | None:
        """The numbers of lines, by the lines' numbers (L,); None where one is none, or has more digits than usual.

        `faces` allows for textures and normals, as faces of OBJ files have them.
        """
        from sdm.kernels.text.number_rows import parse_lines

        _, firsts, counts = self._scanned
        words = counts[lines]
        values = parse_lines(self._text, firsts[lines], words, obj=self._obj, faces=faces)
        lengths = words.astype(np.int64)
        return None if values is None else TextRows(values, np.cumsum(lengths) - lengths, lengths)

    def rows_alike(self, lines: np.ndarray | slice, *, skip: int = 0, faces: bool = False) -> TextRows | None:
        """As `rows`, of lines that have as many words as the first of them, whose words nobody has counted.

        None also where one has more or fewer. `skip` letters at the begin of each line are passed over.
        """
        from sdm.kernels.text.number_rows import parse_alike

        firsts, ends = self._starts[:-1][lines] + np.int32(skip), self._starts[1:][lines]
        if not len(firsts):
            return TextRows.of_table(np.zeros((0, 0)))
        first = self._text[firsts[0] : ends[0]].tobytes()
        words = len((first.partition(b"#")[0] if self._obj else first).split())
        table = parse_alike(self._text, firsts, ends, words, obj=self._obj, faces=faces)
        return None if table is None else TextRows.of_table(table)

    def vertices_and_faces(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Numbers (L,) of the lines of vertices and of faces of an OBJ file, by their first two letters.

        None where these do not tell: where a line begins with a blank, or a keyword with an f goes on.
        """
        begins = self._starts[:-1]
        begins = begins[: np.searchsorted(begins, len(self._text))]
        first = self._text[begins]
        second = self._text[np.minimum(begins + 1, len(self._text) - 1)]
        blank = (second == ord(" ")) | (second == ord("\t"))
        faces = first == ord("f")
        if (faces & ~blank).any() or ((first <= ord(" ")) & (first != ord("\n"))).any():
            return None
        return np.flatnonzero((first == ord("v")) & blank), np.flatnonzero(faces)

    def filled(self, count: int) -> tuple[int, int] | None:
        """The first of `count` lines that follow each other from the first that is not empty, and the end of them."""
        begin = int(np.argmax(np.diff(self._starts) > 1))
        return (begin, begin + count) if begin + count < len(self._starts) else None


def plain_lines(text: bytes) -> bytes:
    """The text with line feeds alone between its lines."""
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in text else text


def as_integers(values: np.ndarray) -> np.ndarray:
    """Whole numbers as int64.

    Raises:
        ValueError: One is not whole.
    """
    if values.dtype.kind != "f":
        return values.astype(np.int64)
    with np.errstate(invalid="ignore"):
        found = values.astype(np.int64)
    wrong = found != values
    if values.size and not (wrong.any() or max(values.max(), -values.min()) >= 2.0**53):
        return found
    wrong |= ~(np.abs(values) < 2.0**53)
    if wrong.any():
        raise ValueError(f"{values[wrong][0]} is no whole number")
    return found


def ragged_index(starts: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Indices (sum of lengths,) of runs of `lengths` (R,) entries that begin at `starts` (R,)."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(starts - before, lengths) + np.arange(int(lengths.sum()))
