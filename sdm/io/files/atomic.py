"""Atomic writes: files that are whole under their final name, or not there."""

from __future__ import annotations

import os
import platform
import secrets
import shutil
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from io import RawIOBase
from pathlib import Path
from typing import Any

from sdm.errors import FormatError
from sdm.io.files.rename_exchange import exchange
from sdm.io.files.stand_in import bring

# What a killed write leaves behind: hidden files or folders that end like this.
LEFTOVER = ".part"
# Of one call that writes; systems take 1,024.
MOST_PIECES = 512
# Bytes of a name on the file systems of Linux.
LONGEST = 255


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A temporary path beside `target`: what the block makes there, a file or a folder, then takes its place.

    The name is `.NAME.PID-TOKEN.part`. If the block fails, nothing is left; if the process is killed, what is left has
    that name and `target` is what it was, or already the new one. Where `target` stands for an address
    (`sdm.io.files.stand_in`) it is then brought there. An older folder changes places with the new one;
    where the file system cannot do that in one step it is put aside first, as `.NAME.PID-TOKEN-old.part`.

    Raises:
        FormatError: The folder is not there, or cannot be written, or the path ends without a name.
    """
    part = _temporary(target)
    try:
        yield part
        if part.is_file():
            _flush(part)
        _take_place(part, target)
        bring(target)
    except OSError as error:
        raise FormatError(f"{target} cannot be written: {error.strerror or error}") from error
    finally:
        remove(part)


def replace_by(target: Path, write: Callable[..., Any], given: tuple[Any, ...]) -> Any:
    """Write a file by a function of its path and more, in place of what is there, and return what that does."""
    with replacing(target) as part:
        return write(part, *given)


def put(target: Path, content: bytes | Path) -> None:
    """Write bytes, or move a file that is on the same disk, to `target`; on the disk before anything else says so.

    The folder is made if it is not there.

    Raises:
        OSError: It cannot be written.
    """
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
        except OSError as error:
            # Of a file that is open the system tells no name.
            error.filename = error.filename or str(target)
            raise
        finally:
            part.unlink(missing_ok=True)
    # Without this a power cut may forget the renaming.
    _flush(target.parent)
    bring(target)


def write_all(file: RawIOBase, pieces: Sequence[bytes | bytearray | memoryview]) -> None:
    """Write pieces to a file that is not buffered, by one call of the system where it has one that takes several.

    Raises:
        OSError: They cannot be written.
    """
    left = [memoryview(piece).cast("B") for piece in pieces if len(piece)]
    while left:
        done = os.writev(file.fileno(), left[:MOST_PIECES]) if hasattr(os, "writev") else file.write(left[0]) or 0
        # A call may write less than it was given.
        while left and done >= len(left[0]):
            done -= len(left.pop(0))
        if left:
            left[0] = left[0][done:]


def try_to_write(target: Path) -> None:
    """Find out whether `target` can be written, without touching it.

    Raises:
        FormatError: The folder is not there, or cannot be written, or the path ends without a name.
    """
    try:
        part = _temporary(target)
        part.touch()
        part.unlink()
    except OSError as error:
        why = error.strerror or error
        raise FormatError(f"{target} cannot be written: {target.parent} does not take new files ({why})") from error


def _temporary(target: Path) -> Path:
    # An empty path, a dot and the root.
    if not target.name:
        raise FormatError(f"{target} cannot be written: it is a folder; give a name in it")
    if not target.parent.is_dir():
        if not target.parent.exists():
            raise FormatError(f"{target} cannot be written: the folder {target.parent} is not there; make it first")
        raise FormatError(f"{target} cannot be written: {target.parent} is not a folder")
    return own_name(target)


def own_name(path: Path) -> Path:
    """A hidden name beside a path, which nobody else takes: `.NAME.PID-TOKEN.part`.

    The token begins with the `machine`, so that `remove_leftovers` knows whose number of a process it is. A name that
    is nearly as long as names may be is cut.
    """
    own = f".{os.getpid()}-{machine()}{secrets.token_hex(4)}{LEFTOVER}"
    name = path.name
    while len(os.fsencode(name)) > LONGEST - len(own) - len(".-old"):
        name = name[:-1]
    return path.with_name(f".{name}{own}")


@cache
def machine() -> str:
    """Eight digits of this machine's name."""
    return f"{zlib.crc32(platform.node().encode()):08x}"


def _flush(path: Path) -> None:
    # Without this a power cut soon after the renaming may leave an empty file under the final name.
    if os.name == "nt" and path.is_dir():
        # Windows flushes no folders, and of files those alone that are open for writing.
        return
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _take_place(part: Path, target: Path) -> None:
    # A link that leads nowhere is in the way of a folder too.
    if not (part.is_dir() and (target.exists() or target.is_symlink())):
        try:
            part.replace(target)
        except OSError:
            # Another process may have put a folder there in the meantime.
            if not (part.is_dir() and target.is_dir()):
                raise
        else:
            return
    if exchange(part, target):
        # What `part` names now is the old one, which goes with it.
        return
    old = part.with_name(f"{part.name.removesuffix(LEFTOVER)}-old{LEFTOVER}")
    target.rename(old)
    try:
        part.rename(target)
    except OSError:
        old.rename(target)
        raise
    remove(old)


def remove(path: Path) -> None:
    """Remove a file or a folder of ours, if that can be."""
    # What a link leads to is not ours.
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    try:
        path.unlink(missing_ok=True)
    except OSError:
        # A folder that cannot be written holds nothing of ours; the write's own error is the one to tell.
        return
