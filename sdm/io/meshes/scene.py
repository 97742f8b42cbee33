"""Scenes that trimesh reads, as one mesh: glTF, COLLADA, 3MF and what else it knows."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sdm.errors import MeshError
from sdm.io.meshes.archive import check_zip
from sdm.io.meshes.collada_looks import without_looks
from sdm.io.meshes.gltf.check import check_gltf
from sdm.io.meshes.polygons import check_indices

if TYPE_CHECKING:
    from trimesh import Scene

ZIPPED = ("zae", "3mf", "3dxml")
# Surfaces in a drawing, of which trimesh takes the lines alone.
DRAWN_FACES = re.compile(rb"^\s*(3DFACE|MESH|POLYLINE)\s*$", re.MULTILINE)


def read_scene(path: Path, ending: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V,3) float64 and triangles (F,3) int64 of all parts of a scene, where it puts them.

    Raises:
        MeshError: trimesh would lose a part, or a face uses a vertex that is not there.
    """
    import trimesh

    if ending in ("glb", "gltf"):
        check_gltf(path)
    if ending in ZIPPED:
        check_zip(path)
    scene = _read_collada(path, ending) if ending in ("dae", "zae") else trimesh.load_scene(path, process=False)
    vertices, faces = _flatten(scene, path)
    if ending == "dxf" and DRAWN_FACES.search(path.read_bytes()):
        raise MeshError(f"{path} is a drawing, whose faces are not read: export it as .stl, .ply or .obj")
    return vertices, faces


def _read_collada(path: Path, ending: str) -> Scene:
    import trimesh
    from collada.common import DaeError

    # What it cannot read trimesh would leave out.
    strict: dict[str, Any] = {"process": False, "ignore_broken": False}
    try:
        return trimesh.load_scene(path, **strict)
    except DaeError:
        if ending != "dae":
            raise
    # Perhaps it is but a camera, a light or a material.
    return trimesh.load_scene(io.BytesIO(without_looks(path.read_bytes())), file_type="dae", **strict)


def _flatten(scene: Scene, path: Path) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    all_vertices, all_faces = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    count = 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        if not isinstance(part, trimesh.Trimesh) or len(part.faces) == 0:
            continue
        vertices, faces = np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise MeshError(f"a vertex of {path} has fewer than 3 coordinates; each needs x, y and z")
        # Here, since the next part's vertices would hide it.
        check_indices(faces, len(vertices), path)
        if not np.array_equal(transform, np.eye(4)):
            vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
            faces = faces[:, ::-1] if np.linalg.det(transform[:3, :3]) < 0 else faces
        all_vertices.append(vertices)
        all_faces.append(faces + count)
        count += len(vertices)
    return np.concatenate(all_vertices), np.concatenate(all_faces)
