"""Pairs of calls: a library's signed distances of points, and ours by the same call. All negative inside here."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from sdm.compat import igl, mesh_to_sdf, open3d, trimesh

# From vertices (V,3) float64, faces (F,3) and points (N,3) float64 to signed distances (N,).
Call = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
# Points that mesh_to_sdf takes of a surface: a tenth of its default, which would take minutes for each mesh.
CLOUD = 1_000_000


def _trimesh(module: Any) -> Call:
    def call(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
        mesh = import_module("trimesh").Trimesh(vertices, faces, process=False)
        return -module.signed_distance(mesh, points)

    return call


def _open3d(scene: Callable[[], Any]) -> Call:
    def call(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
        tensor = import_module("open3d").core.Tensor
        made = scene()
        made.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))
        return made.compute_signed_distance(tensor(points.astype(np.float32))).numpy()

    return call


def _igl(module: Any, sign_type: Any) -> Call:
    def call(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
        # Ours would not build the same mesh again.
        igl.forget()
        return module.signed_distance(points, vertices, faces.astype(np.int64), sign_type)[0]

    return call


def _mesh_to_sdf(module: Any) -> Call:
    def call(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
        mesh = import_module("trimesh").Trimesh(vertices, faces, process=False)
        return module.mesh_to_sdf(mesh, points, "sample", sample_point_count=CLOUD)

    return call


def pairs() -> tuple[dict[str, tuple[Call, Call]], list[str]]:
    """Each installed library's call and ours, by name; and why others are left out, a sentence each."""
    made: dict[str, tuple[Call, Call]] = {}
    left: list[str] = []
    makers: dict[str, Callable[[], tuple[Call, Call]]] = {
        "trimesh.proximity.signed_distance": lambda: (
            _trimesh(_needing("trimesh.proximity", "rtree")),
            _trimesh(trimesh),
        ),
        "open3d RaycastingScene": lambda: (
            _open3d(import_module("open3d").t.geometry.RaycastingScene),
            _open3d(open3d.RaycastingScene),
        ),
        "igl.signed_distance, pseudonormal": lambda: _igl_pair("pseudonormal"),
        "igl.signed_distance, fast winding number": lambda: _igl_pair("fast_winding_number"),
        "mesh_to_sdf, by a million samples": lambda: (
            _mesh_to_sdf(import_module("mesh_to_sdf")),
            _mesh_to_sdf(mesh_to_sdf),
        ),
    }
    for name, make in makers.items():
        try:
            # Some print as they are imported.
            with contextlib.redirect_stdout(io.StringIO()):
                made[name] = make()
        except (ImportError, OSError, AttributeError) as error:
            left.append(f"{name} is left out: {error}")
    return made, left


def _needing(module: str, also: str) -> Any:
    import_module(also)
    return import_module(module)


def _igl_pair(kind: str) -> tuple[Call, Call]:
    library = import_module("igl")
    return _igl(library, getattr(library, f"SIGNED_DISTANCE_TYPE_{kind.upper()}")), _igl(igl, kind)
