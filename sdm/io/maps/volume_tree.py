"""Volumes of a folder and of all folders in it."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

from sdm.core.given_values import as_path
from sdm.errors import FormatError
from sdm.io.files.file_tree import file_tree
from sdm.io.maps.formats import FORMATS

# A volume that is a folder.
FOLDER = ".zarr"


def placed_volumes(folder: str | Path) -> list[tuple[Path, Path]]:
    """The files of a folder and of those in it that end like maps, each with its place below the folder, sorted.

    A folder that ends with .zarr is a volume itself.

    Raises:
        FormatError: A folder that cannot be read, whose volumes would be left out.
    """
    root = as_path(folder)
    if is_volume_folder(root):
        return [(root, Path(root.name))]
    return file_tree(root, tuple(f".{ending}" for ending in FORMATS), _refuse, (FOLDER,))


def is_volume_folder(path: Path) -> bool:
    """True if a folder is a volume by its name."""
    return path.name.lower().endswith(FOLDER)


def _refuse(error: OSError) -> NoReturn:
    raise FormatError(
        f"the folder {error.filename} cannot be read ({error.strerror}), and its volumes would be left out: make it "
        "readable, or name the folders beside it"
    ) from error
