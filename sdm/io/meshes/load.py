"""Meshes from files."""

from __future__ import annotations

import warnings
from pathlib import Path
from stat import S_ISDIR

import numpy as np

from sdm.core.given_values import as_path
from sdm.core.mesh import LARGEST_COORDINATE, TriangleMesh
from sdm.errors import FormatError, MeshError, one_line
from sdm.io.files.list_files import visible
from sdm.io.files.remote import is_remote, local_copy
from sdm.io.files.stand_in import address_of
from sdm.io.meshes.archive import unpacked
from sdm.io.meshes.arrays.triangles import checked_and_merged
from sdm.io.meshes.formats import ARCHIVES, READERS, ending_of, mesh_endings
from sdm.io.meshes.polygons import check_indices, triangulate
from sdm.io.meshes.scene import read_scene


def load_mesh(path: str | Path) -> TriangleMesh:
    """Read a triangle mesh: STL, PLY, OBJ, OFF, GLB, glTF, VTK's `.vtk` and `.vtp`, GIfTI and FreeSurfer's surfaces.

    With the extra `formats` also COLLADA, 3MF, 3DXML and XAML; each compressed too, as `.ply.gz`, and archives of them.

    Args:
        path: The file, or its address, such as `s3://bucket/mesh.ply` (extra `remote`).

    Returns:
        The mesh, named like the file. Scenes are one mesh, each part where the scene puts it; polygons are cut into
        triangles, concave ones of OBJ, PLY and OFF too; every face is kept, zero-area and repeated ones too. Vertices
        at exactly equal positions (after rounding to float32) are merged, so that a closed STL file is closed.

    Raises:
        MeshError: No such file, a folder, an ending that is not known, a file that is damaged or holds no triangles,
            holds fewer faces than it declares, a coordinate that is not finite, a face index out of range, or
            triangles that would be lost or misplaced (glTF files with Draco compression, sparse accessors, normalized
            integers, fans or instances).
    """
    if is_remote(path):
        try:
            with local_copy(str(path)) as local:
                return load_mesh(local)
        except FormatError as error:
            raise MeshError(str(error)) from error
    source = as_path(path, MeshError)
    if (address := address_of(source)) is not None:
        return load_mesh(address)
    _check_file(source)
    vertices, faces = _read(source, ending_of(source))
    # Whatever read them has looked at the indices.
    vertices, faces, largest = checked_and_merged(vertices, faces, source)
    return TriangleMesh(vertices, faces, source.name, check=largest > LARGEST_COORDINATE)


def mesh_files(folder: str | Path) -> list[Path]:
    """The mesh files of a folder, by their endings, sorted by name; not those of folders in it, and no hidden ones.

    Raises:
        MeshError: A folder that cannot be read.
    """
    place, endings = as_path(folder, MeshError), mesh_endings()
    try:
        return [path for path in visible(place) if path.is_file() and path.name.lower().endswith(endings)]
    except OSError as error:
        raise MeshError(f"the folder {place} cannot be read: {error.strerror or error}") from error


def _check_file(path: Path) -> None:
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError) as error:
        if path.is_symlink():
            raise MeshError(f"{path} is a link to {path.readlink()}, which is not there") from error
        raise MeshError(f"there is no mesh file {path}") from error
    except OSError as error:
        raise MeshError(f"{path} cannot be read: {error.strerror or error}") from error
    if S_ISDIR(found.st_mode):
        raise MeshError(f"{path} is a folder; give a mesh file")
    if found.st_size == 0:
        raise MeshError(f"{path} is empty")


def _read(path: Path, ending: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V,3) and faces (F,3) of a file, floats and integers; whatever is wrong with it is one sentence."""
    try:
        # Messages and outputs carry the name on.
        str(path).encode()
        if ending in READERS:
            mesh = READERS[ending](path.read_bytes(), path)
            check_indices(mesh.corners, len(mesh.vertices), path)
            return mesh.vertices, triangulate(mesh)
        if ending in ARCHIVES:
            return _read_archive(path, ending)
        # A scene is odd only once it is gone through: trimesh keeps rows of any length, and makes hashes of names.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read_scene(path, ending)
    except (MeshError, MemoryError):
        raise
    except ImportError as error:
        raise MeshError(f"{path} cannot be read without {error.name}: pip install '.[formats]' in a clone") from error
    except IndexError as error:
        why = one_line(error)
        raise MeshError(f"{path} cannot be read: a face uses a vertex that is not there ({why})") from error
    except FileNotFoundError as error:
        needed = one_line(error.filename or error)
        raise MeshError(f"{path} cannot be read: it needs {needed}, and that file is not there") from error
    except OSError as error:
        raise MeshError(f"{path} cannot be read: {one_line(error.strerror or error)}") from error
    except UnicodeEncodeError as error:
        raise MeshError(f"{path} cannot be read: its name, or one in it, is not UTF-8; give it another") from error
    # Parsers of damaged files raise whatever they come across.
    except Exception as error:
        # Of these Python says what its code lacks, not what the file does.
        own = isinstance(error, AssertionError | AttributeError | KeyError | NameError | TypeError)
        why = "a part is missing, or of another kind" if own else one_line(error)
        raise MeshError(f"{path} cannot be read; it is damaged, or not what its name says ({why})") from error


def _read_archive(path: Path, ending: str) -> tuple[np.ndarray, np.ndarray]:
    """All meshes of an archive as one."""
    all_vertices, all_faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    count = 0
    with unpacked(path, ending) as folder:
        endings = mesh_endings(packed=False)
        for file in sorted(file for file in folder.rglob("*") if file.is_file()):
            if not file.name.lower().endswith(endings):
                continue
            try:
                vertices, faces = _read(file, ending_of(file))
            except MeshError as error:
                inner = str(error).replace(f"{folder}/", "")
                raise MeshError(f"{path}: {inner}") from error
            all_vertices.append(vertices)
            all_faces.append(faces.astype(np.int64) + count)
            count += len(vertices)
    return np.concatenate(all_vertices), np.concatenate(all_faces)
