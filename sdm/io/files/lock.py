"""Lock of a folder that one process at a time writes to."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sdm.errors import FormatError

try:
    import fcntl
except ImportError:
    # Windows, where a folder cannot be locked like this.
    fcntl = None


@contextmanager
def alone(folder: Path, *, wait: bool = False) -> Iterator[None]:
    """Keep other processes of this machine from writing to a folder at the same time, if they ask so too.

    Of two trainings each would go on from the other's checkpoint; of two that fill a dataset the one that finished it
    would take it away under the hands of the other. The lock goes with its process and those forked meanwhile, however
    they end; a file system that has no locks, and Windows, do without.

    Args:
        folder: It is there already.
        wait: Wait for the other process, instead of refusing.

    Raises:
        FormatError: Another process has it, or it is not there.
    """
    if fcntl is None:
        if not folder.is_dir():
            raise FormatError(f"{folder} cannot be written: there is no such folder")
        yield
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise FormatError(f"{folder} cannot be written: {error.strerror or error}") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            raise FormatError(f"{folder} is being written by another process: wait for it, or end it") from None
        except OSError:
            pass
        yield
    finally:
        os.close(handle)
