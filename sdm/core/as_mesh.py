"""Conversion of foreign meshes: files, pairs of arrays, and those of trimesh, Open3D, PyVista and meshio."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError

# The last stands for meshes of other libraries, none of which is imported here.
MeshLike: TypeAlias = TriangleMesh | str | os.PathLike[str] | tuple[Any, Any] | Any

WANTED = (
    "give a TriangleMesh, the path of a mesh file, a pair (vertices, faces), or a mesh of trimesh, Open3D, PyVista or "
    "meshio"
)


def as_mesh(mesh: MeshLike) -> TriangleMesh:
    """The triangle mesh that `mesh` stands for.

    Args:
        mesh: A `TriangleMesh`, which is returned as it is; a path, which is read as by `load_mesh`; a pair of
            vertices (V,3) and faces (F,3); or a mesh of trimesh (scenes too), Open3D (both kinds), PyVista or meshio,
            whose polygons are cut into triangles. Vertices are not merged, save those of files.

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


def _of_open3d(mesh: Any) -> TriangleMesh:
    return TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles))


def _of_open3d_tensors(mesh: Any) -> TriangleMesh:
    return TriangleMesh(mesh.vertex.positions.cpu().numpy(), mesh.triangle.indices.cpu().numpy())


def _of_polydata(mesh: Any) -> TriangleMesh:
    # After that, a 3 and three vertices for each face.
    surface = mesh.triangulate()
    return TriangleMesh(np.asarray(surface.points), np.asarray(surface.faces).reshape(-1, 4)[:, 1:])


def _of_volume(mesh: Any) -> TriangleMesh:
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
    (("vertices", "faces"), _of_faces),
    (("vertices", "triangles"), _of_open3d),
    (("vertex", "triangle"), _of_open3d_tensors),
    (("points", "faces", "triangulate"), _of_polydata),
    (("points", "extract_surface"), _of_volume),
    (("points", "cells"), _of_meshio),
)
