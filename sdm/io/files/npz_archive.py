"""NumPy archives, `.npz`, written by few large writes: the bytes of `numpy.savez`, without its hundred small calls."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from typing import IO

import numpy as np

# Bytes that are kept as they are, and not gathered with others.
LARGE = 1 << 16


def write_archive(file: IO[bytes], arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays to a file as `numpy.savez` does, to the byte.

    `numpy.savez` copies each array, and seeks and writes some ten times for it. Each of these calls gives up Python's
    lock, and where fifteen threads write, waits to have it back longer than the disk takes.

    Args:
        file: Open for writing, at its begin.
        arrays: By their names in the archive.
    """
    pieces = _Pieces()
    with zipfile.ZipFile(pieces, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:  # type: ignore[arg-type]
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                if array.flags.c_contiguous and array.nbytes >= LARGE and not array.dtype.hasobject:
                    head = np.lib.format.header_data_from_array_1_0(array)
                    np.lib.format.write_array_header_1_0(member, head)
                    member.write(array.reshape(-1).view(np.uint8).data)
                else:
                    np.lib.format.write_array(member, array, allow_pickle=False)
    for piece in pieces.held:
        file.write(piece)


class _Pieces:
    """A file in memory for `zipfile`: large pieces by reference, small ones gathered between them.

    Written over are small pieces alone: the headers to which `zipfile` comes back.
    """

    def __init__(self) -> None:
        self.held: list[bytearray | memoryview] = []
        self._starts: list[int] = []
        self._at = self._end = 0

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = offset + (0, self._at, self._end)[whence]
        return self._at

    def flush(self) -> None:
        """Nothing is on its way to a disk."""

    def write(self, data: bytes | memoryview) -> int:
        view = memoryview(data)
        if self._at < self._end:
            number = max(n for n, start in enumerate(self._starts) if start <= self._at)
            begin = self._at - self._starts[number]
            self.held[number][begin : begin + len(view)] = view
        elif len(view) >= LARGE:
            self._append(view)
        else:
            if not self.held or isinstance(self.held[-1], memoryview):
                self._append(bytearray())
            self.held[-1] += view  # type: ignore[operator]
        self._at += len(view)
        self._end = max(self._end, self._at)
        return len(view)

    def _append(self, piece: bytearray | memoryview) -> None:
        self.held.append(piece)
        self._starts.append(self._end)
