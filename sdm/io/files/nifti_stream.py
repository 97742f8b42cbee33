"""Bytes of a NIfTI file from its header and its values, plain or packed. It imports little: see `worker_processes`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sdm.core.axis_order import reversed_axes
from sdm.io.files.checksum import checksum_of
from sdm.io.files.direct_file import DirectFile
from sdm.io.files.gzip_packer import packed
from sdm.io.files.thread_room import thread_room

# Bytes of values that are turned, packed and written at once: they lie with x fastest in a file, and of many threads
# each waits for Python's lock after every call.
TURNED = 1 << 24
# Values whose signs are held at a time.
COUNTED = 1 << 16


def pieces(head: bytes, values: np.ndarray) -> Iterator[np.ndarray]:
    """Content of a file: all that is before the values, and these, (nx,ny,nz) float32.

    Each piece (n,) holds until the next one is asked for.
    """
    yield np.frombuffer(head, np.uint8)
    nx, ny, nz = values.shape
    layers = max(1, TURNED // (4 * nx * ny))
    for begin in range(0, nz, layers):
        part = values[:, :, begin : begin + layers]
        turned = thread_room("turned", part.nbytes)
        reversed_axes(part, turned.view(part.dtype).reshape(-1, ny, nx))
        yield turned


def write_file(path: Path, head: bytes, values: np.ndarray) -> None:
    """Write a new file, packed by gzip: see `pieces`."""
    with DirectFile(path, values.nbytes) as file:
        for piece in packed(pieces(head, values)):
            file.write(piece)


def write_and_count(path: Path, head: bytes, values: np.ndarray, at: int, begin: int) -> int:
    """As `write_file`, where nobody has looked at the values yet: the number of those that are negative.

    Args:
        path: The file.
        head: With room for the values' checksum.
        values: (nx,ny,nz) float32.
        at: Place of the checksum.
        begin: What it begins with: see `checksum_of`.
    """
    checksum = checksum_of(values, begin).encode()
    write_file(path, head[:at] + checksum + head[at + len(checksum) :], values)
    flat = values.reshape(-1)
    return sum(int(np.count_nonzero(flat[one : one + COUNTED] < 0)) for one in range(0, len(flat), COUNTED))
