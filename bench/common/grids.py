"""Grids around a mesh that the benchmarks use."""

from __future__ import annotations

import numpy as np

import sdm
from sdm.bench.common.meshes import Case

# Columns of a turn about no axis of the grid, to full float64 precision.
TURN = np.linalg.qr(np.array([[0.8, -0.6, 0.1], [0.5, 0.7, -0.4], [0.2, 0.3, 0.9]]))[0]


def cube_around(case: Case, resolution: int) -> sdm.Grid:
    """The cube of voxels around a mesh."""
    return sdm.Grid.around(_mesh(case), resolution=resolution)


def turned_around(case: Case, resolution: int) -> sdm.Grid:
    """Unequal spacing along axes that are turned against the mesh's, around its middle: voxels up to twice as long."""
    low, high = _mesh(case).bounds
    extent = 1.2 * (high - low).max()
    shape = np.array([resolution, resolution * 3 // 4, resolution // 2])
    spacing = extent / (shape - 1)
    origin = (low + high) / 2 - TURN @ (spacing * (shape - 1) / 2)
    return sdm.Grid(origin, spacing, shape, TURN)


def sliced_around(case: Case, across: int, count: int) -> sdm.Grid:
    """The cube of voxels around a mesh, as many across, in so many slices along z."""
    cube = cube_around(case, across)
    shape = np.array([across, across, count])
    spacing = np.array(cube.spacing) * across / shape
    return sdm.Grid(np.array(cube.origin) + 0.5 * (spacing - cube.spacing), spacing, shape)


def _mesh(case: Case) -> sdm.TriangleMesh:
    return sdm.TriangleMesh(case.vertices, case.faces, case.name)
