"""Ways to make a surface of a map: ours, and the libraries' that are installed, each with vertices and faces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import sdm

Surface = tuple[np.ndarray, np.ndarray]
OURS = ("sdm cubes", "sdm dual by the map", "sdm dual by the mesh", "sdm band")


def methods_of(
    field: sdm.SDM, index: sdm.MeshIndex, band: sdm.SparseSDM, *, alone: bool = False
) -> dict[str, Callable[[], Any]]:
    """Calls that give a surface each: of ours a mesh on the device, of others, unless `alone`, arrays on the host."""
    calls: dict[str, Callable[[], Any]] = {
        "sdm cubes": field.to_mesh,
        "sdm dual by the map": lambda: field.to_mesh(method="dual"),
        "sdm dual by the mesh": lambda: field.to_mesh(method="dual", mesh=index),
        "sdm band": band.to_mesh,
    }
    if alone:
        return calls
    values = field.numpy()
    return calls | _scikit_image(field, values) | _libigl(field, values)


def _scikit_image(field: sdm.SDM, values: np.ndarray) -> dict[str, Callable[[], Any]]:
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        return {}

    def call() -> Surface:
        index, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
        return index * np.asarray(field.grid.spacing) + np.asarray(field.grid.origin), faces

    return {"scikit-image": call}


def _libigl(field: sdm.SDM, values: np.ndarray) -> dict[str, Callable[[], Any]]:
    try:
        import igl
    except ImportError:
        return {}
    nx, ny, nz = field.shape
    points = field.grid.points().permute(2, 1, 0, 3).reshape(-1, 3).double().numpy()
    flat = np.ascontiguousarray(values.transpose(2, 1, 0)).reshape(-1).astype(np.float64)

    def call() -> Surface:
        vertices, faces = igl.marching_cubes(flat, points, nx, ny, nz, 0.0)[:2]
        return np.asarray(vertices), np.asarray(faces)

    return {"libigl": call}
