"""Meshes of a folder and of the folders in it, as `sdm.load_mesh` reads them or as NumPy archives."""

from __future__ import annotations

import zipfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdm import load_mesh
from sdm.bench.common.meshes import Case
from sdm.core.mesh import TriangleMesh
from sdm.errors import FormatError, MeshError
from sdm.io.meshes.formats import ARCHIVES, DRAWINGS, known_endings

NUMPY = ".npz"


@dataclass(frozen=True)
class Found:
    """A file of a folder: where it is, and its name in there, with `/` between folders and without .npz at the end."""

    path: Path
    name: str

    def load(self) -> TriangleMesh:
        """Its mesh; a NumPy archive needs `vertices` (V,3) and `faces` (F,3).

        Raises:
            MeshError: It cannot be read, or holds no mesh.
        """
        if self.path.suffix != NUMPY:
            return load_mesh(self.path)
        try:
            with np.load(self.path) as arrays:
                return TriangleMesh(arrays["vertices"], arrays["faces"], self.name)
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            if isinstance(error, MeshError):
                raise
            raise MeshError(f"{self.path} holds no arrays `vertices` and `faces` of a mesh: {error}") from error


def files_of(folder: Path) -> Iterator[Found]:
    """The files with the ending of a mesh, by name, drawings and archives left out; what is in them is not looked at.

    Raises:
        FormatError: No such folder.
    """
    if not folder.is_dir():
        raise FormatError(f"there is no folder {folder} with meshes")
    paths = sorted(folder.rglob("*"))
    if not any(_is_read(path) and path.is_file() for path in paths):
        raise FormatError(f"there is no mesh file in {folder}")
    for path in paths:
        if _is_read(path) and path.is_file():
            yield Found(path, path.relative_to(folder).as_posix().removesuffix(NUMPY))


def other_endings(folder: Path) -> dict[str, int]:
    """Numbers of files of a folder with other endings, the usual ones first."""
    others = (path.suffix.lower() for path in folder.rglob("*") if path.is_file() and not _is_read(path))
    return dict(Counter(others).most_common())


def _is_read(path: Path) -> bool:
    endings = (f".{ending}" for ending in known_endings() if ending not in (*ARCHIVES, *DRAWINGS))
    return path.name.lower().endswith((*endings, NUMPY))


def meshes_of(folder: Path, least: int) -> Iterator[Case]:
    """The meshes of a folder that load and have at least so many triangles."""
    for found in files_of(folder):
        try:
            mesh = found.load()
        except MeshError:
            continue
        if len(mesh) >= least:
            yield as_case(mesh, found.name)


def as_case(mesh: TriangleMesh, name: str) -> Case:
    """A mesh for the benchmarks."""
    return Case(name, mesh.vertices.numpy(), mesh.faces.numpy(), frozenset(("own",)))
