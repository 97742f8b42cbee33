"""Conversion of foreign meshes: files, pairs of arrays, and the meshes of other libraries, told by what they have."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np

from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError

# The last stands for meshes of other libraries, none of which is imported here.
MeshLike: TypeAlias = TriangleMesh | str | os.PathLike[str] | tuple[Any, Any] | Any

WANTED = (
    "give a TriangleMesh, the path of a mesh file, a pair (vertices, faces), or a mesh of trimesh, Open3D, PyVista, "
    "meshio, MeshLib, Kaolin or PyTorch3D"
)


def as_mesh(mesh: MeshLike) -> TriangleMesh:
    """The triangle mesh that `mesh` stands for.

    Args:
        mesh: A `TriangleMesh`, which is returned as it is; a path, which is read as by `load_mesh`; a pair of
            vertices (V,3) and faces (F,3); or a mesh of trimesh (scenes too), Open3D (both kinds), PyVista (blocks
            too), meshio, MeshLib, Kaolin or PyTorch3D, whose polygons are cut into triangles. Tensors stay on their
            device, and gradients flow to them. Vertices are not merged, save those of files.

    Raises:
        MeshError: It is nothing of these, or a mesh that cannot be used.
    """
    if isinstance(mesh, TriangleMesh):
        return mesh
    if isinstance(mesh, str | os.PathLike):
        from sdm.io import load_mesh

        return load_mesh(os.fspath(mesh))
    if isinstance(mesh, tuple | list) and len(mesh) == 2:
        return TriangleMesh(*mesh)
    for attributes, convert in _KINDS:
        if all(hasattr(mesh, name) for name in attributes):
            return convert(mesh)
    what = f"{type(mesh).__name__} of {len(mesh)}" if isinstance(mesh, tuple | list) else type(mesh).__name__
    raise MeshError(f"an object of type {what} is no mesh: {WANTED}")


def _of_scene(scene: Any) -> TriangleMesh:
    return _of_faces(scene.to_mesh())


def _of_faces(mesh: Any) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.faces)


def _of_kaolin(mesh: Any) -> TriangleMesh:
    # One mesh, or a batch that holds one: of arrays with a first axis, or of lists; faces may be shared.
    vertices, faces = mesh.vertices, mesh.faces
    if isinstance(vertices, list | tuple) or vertices.ndim == 3:
        _require_one(mesh, len(vertices))
        vertices = vertices[0]
    if isinstance(faces, list | tuple) or faces.ndim == 3:
        faces = faces[0]
    return TriangleMesh(vertices, faces)


def _of_pytorch3d(mesh: Any) -> TriangleMesh:
    _require_one(mesh, len(mesh))
    return TriangleMesh(mesh.verts_list()[0], mesh.faces_list()[0])


def _require_one(mesh: Any, count: int) -> None:
    if count != 1:
        raise MeshError(
            f"a {type(mesh).__name__} of {count} meshes is not one: give one of them, or a list of them to "
            "signed_distance_maps"
        )


def _of_meshlib(mesh: Any) -> TriangleMesh:
    # Whoever has such a mesh has its library; what is packed has no numbers of deleted faces.
    arrays = import_module("meshlib.mrmeshnumpy")
    return TriangleMesh(arrays.getNumpyVerts(mesh), _kept(arrays, mesh.topology))


def _kept(arrays: Any, topology: Any) -> np.ndarray:
    faces = np.asarray(arrays.getNumpyFaces(topology))
    valid = np.asarray(arrays.getNumpyBitSet(topology.getValidFaces()))
    return faces[np.flatnonzero(valid[: len(faces)])]


def _of_open3d(mesh: Any) -> TriangleMesh:
    return TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles))


def _of_open3d_tensors(mesh: Any) -> TriangleMesh:
    return TriangleMesh(mesh.vertex.positions.cpu().numpy(), mesh.triangle.indices.cpu().numpy())


def _of_polydata(mesh: Any) -> TriangleMesh:
    # After that, a 3 and three vertices for each face.
    surface = mesh.triangulate()
    return TriangleMesh(np.asarray(surface.points), np.asarray(surface.faces).reshape(-1, 4)[:, 1:])


def _of_blocks(mesh: Any) -> TriangleMesh:
    return _of_volume(mesh.combine())


def _of_volume(mesh: Any) -> TriangleMesh:
    # PyVista 0.47 and later warn of an algorithm that they will choose by themselves.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _of_polydata(mesh.extract_surface())


def _of_meshio(mesh: Any) -> TriangleMesh:
    found = []
    for block in mesh.cells:
        if block.type in ("triangle", "quad"):
            corners = np.asarray(block.data)
            found += [corners[:, [0, i, i + 1]] for i in range(1, corners.shape[1] - 1)]
        elif block.type.startswith(("triangle", "quad", "polygon")):
            raise MeshError(f"a meshio mesh has cells of type {block.type}: only triangles and quads are taken")
    if not found:
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "nothing"
        raise MeshError(f"a meshio mesh has no triangles, but {kinds}: extract its surface first")
    points = np.asarray(mesh.points)
    return TriangleMesh(points, np.concatenate(found))


# Attributes that tell a library's meshes, in the order in which they are looked for.
_KINDS: tuple[tuple[tuple[str, ...], Callable[[Any], TriangleMesh]], ...] = (
    (("geometry", "to_mesh"), _of_scene),
    (("vertices", "faces", "batching"), _of_kaolin),
    (("verts_list", "faces_list"), _of_pytorch3d),
    (("vertices", "faces"), _of_faces),
    (("points", "topology"), _of_meshlib),
    (("vertices", "triangles"), _of_open3d),
    (("vertex", "triangle"), _of_open3d_tensors),
    (("points", "faces", "triangulate"), _of_polydata),
    (("n_blocks", "combine"), _of_blocks),
    (("points", "extract_surface"), _of_volume),
    (("points", "cells"), _of_meshio),
)
