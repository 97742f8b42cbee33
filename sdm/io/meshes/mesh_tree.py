"""Mesh files of a folder and of all folders in it."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

from sdm.core.given_values import as_path
from sdm.errors import MeshError
from sdm.io.meshes.formats import mesh_endings


def mesh_tree(folder: str | Path) -> list[Path]:
    """The mesh files of a folder and of the folders in it, by their endings, sorted by path; no hidden ones.

    Links to folders are followed, but no folder is gone through twice. A link to a file that is not there is among
    them, so that whoever reads it says so.

    Raises:
        MeshError: A folder that cannot be read, whose meshes would be left out.
    """
    return [path for path, _ in placed_meshes(folder)]


def placed_meshes(folder: str | Path) -> list[tuple[Path, Path]]:
    """Those of `mesh_tree`, each with its place below the folder."""
    found = sorted(_files(as_path(folder, MeshError)))
    return [(Path(path), Path(*place)) for place, path in found]


def _files(root: Path) -> Iterator[tuple[tuple[str, ...], str]]:
    """Each as the parts of its place below the root, and its path."""
    endings, seen = mesh_endings(), set()
    waiting: list[tuple[str, tuple[str, ...]]] = [(str(root), ())]
    while waiting:
        folder, above = waiting.pop()
        try:
            found = Path(folder).stat()
            with os.scandir(folder) as all_entries:
                entries = [entry for entry in all_entries if not entry.name.startswith(".")]
        except OSError as error:
            _refuse(error)
        if (found.st_dev, found.st_ino) in seen:
            continue
        seen.add((found.st_dev, found.st_ino))
        folders = [(entry.name, entry.path) for entry in entries if _is_folder(entry)]
        waiting += [(path, (*above, name)) for name, path in sorted(folders, reverse=True)]
        meshes = [e for e in entries if e.name.lower().endswith(endings) and not _is_folder(e) and _is_file(e)]
        if meshes and not os.access(folder, os.X_OK):
            # Its names may be read, and nothing else.
            _refuse(PermissionError(errno.EACCES, os.strerror(errno.EACCES), folder))
        yield from (((*above, entry.name), entry.path) for entry in meshes)


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


def _refuse(error: OSError) -> NoReturn:
    raise MeshError(
        f"the folder {error.filename} cannot be read ({error.strerror}), and its meshes would be left out: make it "
        "readable, or name the folders beside it"
    ) from error
