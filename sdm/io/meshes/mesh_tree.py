"""Mesh files of a folder and of all folders in it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from stat import S_ISREG

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
    return [path for _, path in sorted(_files(as_path(folder, MeshError)))]


def _files(root: Path) -> Iterator[tuple[tuple[str, ...], Path]]:
    """Each with the parts of its place below the root."""
    endings, seen = mesh_endings(), set()
    for place, folders, names in os.walk(root, followlinks=True, onerror=_refuse):
        found = Path(place).stat()
        if (found.st_dev, found.st_ino) in seen:
            folders.clear()
            continue
        seen.add((found.st_dev, found.st_ino))
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        above = Path(place).relative_to(root).parts
        for name in names:
            if name.lower().endswith(endings) and not name.startswith("."):
                path = Path(place, name)
                if _is_file(path):
                    yield (*above, name), path


def _is_file(path: Path) -> bool:
    try:
        return S_ISREG(path.stat().st_mode)
    except PermissionError as error:
        # A folder whose names may be read, and nothing else.
        error.filename = str(path.parent)
        _refuse(error)
    except OSError:
        # A link that leads nowhere, or to itself.
        pass
    return True


def _refuse(error: OSError) -> None:
    raise MeshError(
        f"the folder {error.filename} cannot be read ({error.strerror}), and its meshes would be left out: make it "
        "readable, or name the folders beside it"
    ) from error
