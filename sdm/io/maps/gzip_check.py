"""Check of files that nibabel reads; of gzip files to the end, where their checksum is."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from isal import igzip, isal_zlib
from nibabel.fileholders import FileHolder

from sdm.errors import FormatError, one_line

BLOCK = 1 << 20
# Its types call this an instance.
DAMAGED: type[Exception] = cast("type[Exception]", isal_zlib.error)


@contextmanager
def held(path: Path) -> Iterator[FileHolder]:
    """A file as nibabel takes it. What the block leaves of a `.gz` is read after it: gzip checks its sum at the end.

    Raises:
        FormatError: The content is not what was packed, is cut off, or is not gzip, though the name says so.
    """
    if not path.name.lower().endswith(".gz"):
        yield FileHolder(str(path))
        return
    try:
        # Twice as fast as Python's own.
        with igzip.open(path, "rb") as file:
            yield FileHolder(fileobj=file)
            while file.read(BLOCK):
                pass
    except (gzip.BadGzipFile, EOFError, DAMAGED) as error:
        why = one_line(error)
        raise FormatError(f"{path} cannot be read; it is damaged, or not what its name says ({why})") from error
