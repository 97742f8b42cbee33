"""Meshes from files, and to PLY."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError
from sdm.inspect.positions import first_at_position
from sdm.io.files.atomic import replacing
from sdm.io.files.list_files import visible
from sdm.io.files.one_line import one_line
from sdm.io.meshes.check_truncated import check_whole
from sdm.io.meshes.mixed_ply import read_mixed
from sdm.io.meshes.polygons import cut_ply, cut_text

# The endings that messages name first.
USUAL = ("stl", "ply", "obj", "off", "glb", "gltf")
# Archives and drawings hold a mesh if someone says so, but are not taken for one in a folder.
NOT_ALWAYS = {"zip", "bz2", "tar.gz", "tar.bz2", "dxf", "xyz", "svg"}


def load_mesh(path: str | Path) -> TriangleMesh:
    """Read a triangle mesh: STL, PLY, OBJ, OFF, GLB, glTF, and whatever else trimesh reads.

    Args:
        path: The file.

    Returns:
        The mesh, named like the file. Scenes are one mesh, each part where the scene puts it; polygons are cut into
        triangles, concave ones of OBJ, PLY and OFF too; every face is kept, zero-area and repeated ones too. Vertices
        at exactly equal positions (after rounding to float32) are merged, so that a closed STL file is closed.

    Raises:
        MeshError: No such file, a folder, an ending that is not known, a file that is damaged or holds no triangles,
            a coordinate that is not finite, a face index out of range, or triangles that trimesh would lose or
            misplace (glTF files with Draco compression, sparse accessors, normalized integers, fans or instances).
    """
    source = Path(path)
    _check_file(source)
    vertices, faces = _read(source)
    if len(faces) == 0:
        raise MeshError(f"{source} has no triangles; give a surface mesh, not points or lines")
    wrong = ~np.isfinite(vertices).all(1) | (np.abs(vertices) > np.finfo(np.float32).max).any(1)
    if wrong.any():
        index = int(np.flatnonzero(wrong)[0])
        raise MeshError(f"vertex {index} of {source} is {vertices[index].tolist()}; every coordinate must be finite")
    vertices, faces = _merge(vertices.astype(np.float32), faces)
    return TriangleMesh(vertices, faces, source.name)


def write_ply(mesh: TriangleMesh, path: str | Path) -> None:
    """Write a mesh as binary PLY, atomically.

    Raises:
        FormatError: A place that cannot be written.
    """
    import trimesh
    from trimesh.exchange.ply import export_ply

    with replacing(Path(path)) as part:
        part.write_bytes(export_ply(trimesh.Trimesh(*mesh.numpy(), process=False)))


def mesh_files(folder: str | Path) -> list[Path]:
    """The mesh files of a folder, by their endings, sorted by name; not those of folders in it, and no hidden ones."""
    import trimesh

    endings = tuple(f".{ending}" for ending in trimesh.available_formats() - NOT_ALWAYS)
    return [path for path in visible(Path(folder)) if path.is_file() and path.name.lower().endswith(endings)]


def _check_file(path: Path) -> None:
    import trimesh

    try:
        there = path.exists()
    except OSError as error:
        raise MeshError(f"{path} cannot be read: {error.strerror or error}") from error
    if not there:
        raise MeshError(f"there is no mesh file {path}")
    if path.is_dir():
        raise MeshError(f"{path} is a folder; give a mesh file")
    if path.stat().st_size == 0:
        raise MeshError(f"{path} is empty")
    known = trimesh.available_formats()
    if not any(path.name.lower().endswith(f".{ending}") for ending in known):
        others = sorted(set(known) - set(USUAL))
        ending = f"ending {path.suffix}" if path.suffix else "name without an ending"
        raise MeshError(f"{path}: no mesh has the {ending}; known are .{', .'.join((*USUAL, *others))}")


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V,3) float64 and faces (F,3) int64 of a file; whatever is wrong with it is one sentence."""
    try:
        check_whole(path)
        # A scene is odd only once it is gone through: trimesh keeps rows of any length, and makes hashes of names.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mixed = read_mixed(path.read_bytes()) if path.suffix.lower() == ".ply" else None
            if mixed is not None:
                _check_indices(mixed[1], len(mixed[0]), path)
                return mixed
            return _flatten(_parse(path), path)
    except (MeshError, MemoryError):
        raise
    except IndexError as error:
        why = one_line(error)
        raise MeshError(f"{path} cannot be read: a face uses a vertex that is not there ({why})") from error
    except OSError as error:
        raise MeshError(f"{path} cannot be read: {one_line(error.strerror or error)}") from error
    except UnicodeEncodeError as error:
        raise MeshError(f"{path} cannot be read: its name, or one in it, is not UTF-8; give it another") from error
    # Parsers of damaged files raise whatever they come across.
    except Exception as error:
        why = one_line(error)
        raise MeshError(f"{path} cannot be read; it is damaged, or not what its name says ({why})") from error


def _parse(path: Path) -> Any:
    """What trimesh makes of a file."""
    import trimesh

    options: dict[str, Any] = {"skip_materials": True} if path.suffix.lower() == ".obj" else {}
    text = cut_text(path)
    if text is None:
        return trimesh.load_scene(path, process=False, **options)
    return trimesh.load_scene(BytesIO(text), file_type=path.suffix[1:].lower(), process=False, **options)


def _flatten(scene: Any, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """All triangles of a scene where it puts them: vertices (V,3) float64, faces (F,3) int64."""
    import trimesh

    all_vertices, all_faces = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    count = 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        if not isinstance(part, trimesh.Trimesh) or len(part.faces) == 0:
            continue
        vertices, faces = cut_ply(part) or (np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64))
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise MeshError(f"a vertex of {path} has fewer than 3 coordinates; each needs x, y and z")
        # Here, since the next part's vertices would hide it.
        _check_indices(faces, len(vertices), path)
        if not np.array_equal(transform, np.eye(4)):
            vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
            faces = faces[:, ::-1] if np.linalg.det(transform[:3, :3]) < 0 else faces
        all_vertices.append(vertices)
        all_faces.append(faces + count)
        count += len(vertices)
    return np.concatenate(all_vertices), np.concatenate(all_faces)


def _check_indices(faces: np.ndarray, count: int, path: Path) -> None:
    if len(faces) and (faces.min() < 0 or faces.max() >= count):
        bad = int(faces.min() if faces.min() < 0 else faces.max())
        raise MeshError(f"a face of {path} uses vertex {bad}, but it has {count} vertices counted from 0")


def _merge(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drop vertices at the position of an earlier one; the order of the others stays."""
    first = first_at_position(vertices)
    kept = first == np.arange(len(vertices))
    number = np.cumsum(kept) - 1
    return vertices[kept], number[first[faces]].astype(np.int32)
