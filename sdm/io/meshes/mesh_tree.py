"""Mesh files of a folder and of all folders in it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from sdm.io.meshes.formats import mesh_endings


def mesh_tree(folder: str | Path) -> list[Path]:
    """The mesh files of a folder and of the folders in it, by their endings, sorted by path; no hidden ones.

    Links to folders are followed, but no folder is gone through twice.
    """
    root = Path(folder)
    return sorted(_files(root), key=lambda path: path.relative_to(root).parts)


def _files(root: Path) -> Iterator[Path]:
    endings, seen = mesh_endings(), set()
    for place, folders, names in os.walk(root, followlinks=True):
        found = Path(place).stat()
        if (found.st_dev, found.st_ino) in seen:
            folders.clear()
            continue
        seen.add((found.st_dev, found.st_ino))
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in names:
            if name.lower().endswith(endings) and not name.startswith("."):
                path = Path(place, name)
                if path.is_file():
                    yield path
