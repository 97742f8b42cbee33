"""Files of a folder and of all folders in it, by their endings."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn


def file_tree(
    root: Path,
    endings: tuple[str, ...],
    refuse: Callable[[OSError], NoReturn],
    folders: tuple[str, ...] = (),
) -> list[tuple[Path, Path]]:
    """The files, each with its place below the root, sorted by place; no hidden ones.

    Links to folders are followed, but no folder is gone through twice. A link to a file that is not there is among
    them, so that whoever reads it says so.

    Args:
        root: The folder.
        endings: Of names of files, in small letters.
        refuse: What raises the error of a folder that cannot be read.
        folders: Endings of folders that are taken for files, and not gone through.
    """
    found = sorted(_files(root, endings, folders, refuse))
    return [(Path(path), Path(*place)) for place, path in found]


def _files(
    root: Path, endings: tuple[str, ...], whole: tuple[str, ...], refuse: Callable[[OSError], NoReturn]
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Each as the parts of its place below the root, and its path."""
    seen = set()
    waiting: list[tuple[str, tuple[str, ...]]] = [(str(root), ())]
    while waiting:
        folder, above = waiting.pop()
        try:
            found = Path(folder).stat()
            with os.scandir(folder) as all_entries:
                entries = [entry for entry in all_entries if not entry.name.startswith(".")]
        except OSError as error:
            refuse(error)
        if (found.st_dev, found.st_ino) in seen:
            continue
        seen.add((found.st_dev, found.st_ino))
        items, inner = [], []
        for entry in entries:
            name = entry.name.lower()
            if _is_folder(entry):
                (items if name.endswith(whole) else inner).append(entry)
            elif name.endswith(endings) and _is_file(entry):
                items.append(entry)
        waiting += [(e.path, (*above, e.name)) for e in sorted(inner, key=lambda e: e.name, reverse=True)]
        if items and not os.access(folder, os.X_OK):
            # Its names may be read, and nothing else.
            refuse(PermissionError(errno.EACCES, os.strerror(errno.EACCES), folder))
        yield from (((*above, entry.name), entry.path) for entry in items)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        # A link that leads nowhere, or to itself, is taken for one.
        return entry.is_file() or (entry.is_symlink() and not Path(entry.path).exists())
    except OSError:
        return True
