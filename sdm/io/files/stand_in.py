"""Stand-ins: files of this machine in place of those at addresses, which commands read and write as any others.

A folder that is read holds a hollow file, of the right size and with no content, for each mesh; `load_mesh` fetches the
mesh itself when it comes to it. What is written into a folder for writing goes to its address as soon as it is whole,
by the thread that wrote it, and leaves a hollow file. So neither takes the disk of more than what is in flight.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any

from sdm.errors import FormatError
from sdm.io.files.remote import asking, file_system

# Records and lists, which are read again, are kept whole.
SMALL, LISTS = 1 << 16, (".json", ".jsonl", ".lst", ".txt")


@dataclass(frozen=True)
class StandIn:
    """A path of this machine that stands for an address, with all that is below it.

    Args:
        place: The path.
        address: Of the file or folder.
        written: Whether what is written there goes to the address.
    """

    place: Path
    address: str
    written: bool


_known: list[StandIn] = []


@contextmanager
def stand_ins() -> Iterator[None]:
    """Stand-ins that are made in the block are gone after it."""
    before = list(_known)
    try:
        yield
    finally:
        for one in [one for one in _known if one not in before]:
            _known.remove(one)
            shutil.rmtree(one.place.parent, ignore_errors=True)


def known() -> tuple[StandIn, ...]:
    """All stand-ins there are, for another process of this machine to `adopt`."""
    return tuple(_known)


def adopt(others: Iterable[StandIn]) -> None:
    """Know the stand-ins of the process that began this one."""
    _known.extend(one for one in others if one not in _known)


def to_read(address: str, *, later: Callable[[str], bool]) -> Path:
    """A stand-in for a file or folder to read.

    Args:
        address: Where it is.
        later: True of the names of files that are fetched when they are needed. Others are fetched now, of a folder
            records and lists alone.

    Raises:
        FormatError: Nothing is there, or it cannot be read.
    """
    files, path = file_system(address)
    # It remembers what was there when it was asked last.
    files.invalidate_cache()
    place = _place(path, address)
    with asking(address):
        if files.isdir(path):
            place.mkdir()
            _hollow_tree(files, path, place, lambda name, size: not later(name) and _is_record(name, size))
        elif not files.exists(path):
            shutil.rmtree(place.parent)
            raise FormatError(f"there is no file {address}")
        elif later(place.name):
            hollow(place, files.size(path) or 1)
        else:
            files.get_file(path, str(place))
    _known.append(StandIn(place, address.rstrip("/"), written=False))
    return place


def to_write(address: str) -> Path:
    """A stand-in for a file or folder to write, which shows what is there already.

    Raises:
        FormatError: It cannot be asked for.
    """
    files, path = file_system(address)
    files.invalidate_cache()
    place, plain = _place(path, address), address.rstrip("/")
    with asking(plain):
        _end_move(files, f"{path}.part", path)
    # Datasets are called so until they are complete.
    for ending in ("", ".part"):
        there = place.with_name(place.name + ending)
        with asking(plain):
            if files.isdir(path + ending):
                there.mkdir()
                _hollow_tree(files, path + ending, there, _is_record)
            elif files.exists(path + ending):
                hollow(there, files.size(path + ending) or 1)
        _known.append(StandIn(there, plain + ending, written=True))
    return place


def address_of(path: Path) -> str | None:
    """The address that a path stands for, if it does."""
    one = _of(path)
    if one is None:
        return None
    return one.address if path == one.place else f"{one.address}/{path.relative_to(one.place).as_posix()}"


def shown(text: object) -> str:
    """A path, or a sentence with paths, by their addresses where they stand for some."""
    said = str(text)
    for one in sorted(_known, key=lambda one: -len(str(one.place))):
        said = said.replace(str(one.place), one.address)
    return said


def bring(path: Path, *, keep: bool = False) -> None:
    """Bring a file or folder that was written to its address, if it has one, in place of what is there.

    Args:
        path: The file or folder.
        keep: It goes on being written, and stays as it is here.

    Raises:
        FormatError: The server does not take it.
    """
    one = _of(path) if _known else None
    if one is None or not one.written:
        return
    address = str(address_of(path))
    files, there = file_system(address)
    with asking(address):
        if path.is_dir():
            if files.exists(there):
                files.rm(there, recursive=True)
            for file in sorted(own for own in path.rglob("*") if own.is_file()):
                _put(files, file, f"{there}/{file.relative_to(path).as_posix()}")
        else:
            _put(files, path, there)
    for file in [path] if path.is_file() else path.rglob("*"):
        if not keep and file.is_file() and not _is_record(file.name, file.stat().st_size):
            hollow(file, file.stat().st_size)


def moved(old: Path, new: Path) -> None:
    """A folder that stood at one path is at another one now, and so at its address.

    Raises:
        FormatError: The server cannot move it.
    """
    one = _of(old) if _known else None
    if one is None or not one.written:
        return
    (files, source), target = file_system(str(address_of(old))), file_system(str(address_of(new)))[1]
    with asking(one.address):
        names = [name.removeprefix(source) for name in files.find(source)]
        # Its own files come last, by which a reader knows that the folder is whole.
        for name in sorted(names, key=lambda name: (-name.count("/"), name)):
            _room_for(files, target + name)
            files.cp_file(source + name, target + name)
        files.rm(source, recursive=True)


def _end_move(files: Any, old: str, new: str) -> None:
    """Clear up after a move that was cut off: what is whole stays, under its new name if that was reached."""
    if not (files.isdir(old) and files.isdir(new)):
        return
    whole = any(about["type"] == "file" for about in files.ls(new, detail=True))
    files.rm(old if whole else new, recursive=True)
    files.invalidate_cache()


def gone(path: Path) -> None:
    """A file was removed, and is to go from its address."""
    one = _of(path) if _known else None
    if one is not None and one.written:
        files, there = file_system(str(address_of(path)))
        with asking(one.address):
            if files.exists(there):
                files.rm(there)


@contextmanager
def fetched(path: Path) -> Iterator[None]:
    """A file or folder with its content, if it is a hollow one; hollow again after the block."""
    address = address_of(path) if _known else None
    if address is None or not path.exists():
        yield
        return
    files, there = file_system(address)
    with asking(address):
        if path.is_dir():
            files.get(there.rstrip("/") + "/", f"{path}/", recursive=True)
        else:
            files.get_file(there, str(path))
    yield
    if path.is_file():
        hollow(path, path.stat().st_size)


def hollow(path: Path, size: int) -> None:
    """Leave a file of so many bytes that takes no place on the disk."""
    with path.open("wb") as file:
        os.truncate(file.fileno(), size)


def _is_record(name: str, size: int) -> bool:
    return size <= SMALL or name.lower().endswith(LISTS)


def _of(path: Path) -> StandIn | None:
    return next((one for one in _known if path == one.place or one.place in path.parents), None)


def _place(path: str, address: str) -> Path:
    name = PurePosixPath(path).name
    if not name:
        raise FormatError(f"{address} has no name: give a file or folder")
    return Path(tempfile.mkdtemp(prefix="sdm-")) / name


def _hollow_tree(files: Any, root: str, place: Path, whole: Callable[[str, int], bool]) -> None:
    for path, about in files.find(root, detail=True).items():
        name = path.removeprefix(root).lstrip("/")
        # Names come from a server: none leads out of the folder.
        if not name or ".." in PurePosixPath(name).parts:
            continue
        local, size = place / name, about.get("size")
        local.parent.mkdir(parents=True, exist_ok=True)
        if size is not None and whole(local.name, size):
            files.get_file(path, str(local))
        else:
            hollow(local, size or 1)
        if (when := _time_of(about)) is not None:
            os.utime(local, ns=(when, when))


def _time_of(about: dict[str, Any]) -> int | None:
    """When a file was last written by its server's clock, in nanoseconds, where that tells."""
    when = next((about[key] for key in ("LastModified", "mtime", "updated", "created") if about.get(key)), None)
    seconds = when.timestamp() if isinstance(when, datetime) else when
    return int(seconds * 10**9) if isinstance(seconds, int | float) else None


def _put(files: Any, local: Path, there: str) -> None:
    _room_for(files, there)
    files.put_file(str(local), there)


def _room_for(files: Any, there: str) -> None:
    files.makedirs(there.rpartition("/")[0], exist_ok=True)
