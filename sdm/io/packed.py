"""Gzip files, read to the end, where their checksum is."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sdm.errors import FormatError
from sdm.io.sentence import one_line

BLOCK = 1 << 20


def is_packed(path: Path) -> bool:
    """Whether a file's name says that it is gzip."""
    return path.name.lower().endswith(".gz")


@contextmanager
def unpacked(path: Path) -> Iterator[gzip.GzipFile]:
    """The content of a `.gz`. What the block leaves is read after it: gzip checks its sum at the end alone.

    Raises:
        FormatError: The content is not what was packed, is cut off, or is not gzip.
    """
    try:
        with gzip.open(path, "rb") as file:
            yield file
            while file.read(BLOCK):
                pass
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        why = one_line(error)
        raise FormatError(f"{path} cannot be read; it is damaged, or not what its name says ({why})") from error
