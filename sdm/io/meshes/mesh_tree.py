"""Mesh files of a folder and of all folders in it."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

from sdm.core.given_values import as_path
from sdm.errors import MeshError
from sdm.io.files.file_tree import file_tree
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
    return file_tree(as_path(folder, MeshError), mesh_endings(), _refuse)


def _refuse(error: OSError) -> NoReturn:
    raise MeshError(
        f"the folder {error.filename} cannot be read ({error.strerror}), and its meshes would be left out: make it "
        "readable, or name the folders beside it"
    ) from error
