"""Files of a dataset: whole under their final name, or not there, and on the disk before anything says so."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sdm.errors import FormatError
from sdm.io.atomic import own_name


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keep other processes of this machine from writing to a dataset at the same time.

    The one that finished it would take it away under the hands of the others. The lock goes with its process, however
    that ends; a file system that has no locks does without.

    Raises:
        FormatError: Another process has it, or it is not there.
    """
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise FormatError(f"{folder} cannot be written: {error.strerror or error}") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FormatError(f"{folder} is being written by another process: wait for it, or end it") from None
        except OSError:
            pass
        yield
    finally:
        os.close(handle)


def put(target: Path, content: bytes | Path) -> None:
    """Write bytes, or move a file that is on the same disk, to `target`."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, Path):
        _flush(content)
        content.replace(target)
    else:
        part = own_name(target)
        try:
            part.write_bytes(content)
            _flush(part)
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)
    _flush(target.parent)


def _flush(path: Path) -> None:
    # Also for folders: without it a power cut may forget the renaming.
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
