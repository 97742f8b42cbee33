"""Whatever stands for a mesh is taken by every public function that wants one, or refused in one sentence."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.bench.common.meshes import cube
from sdm.core.as_mesh import as_mesh

VERTICES, FACES = cube()
MESH = sdm.TriangleMesh(VERTICES, FACES)
POINTS = np.array([[0.0, 0, 0], [2, 0, 0]])
GRID = sdm.Grid([-2, -2, -2], [1, 1, 1], [5, 5, 5])


class PolyData:
    """PyVista's layout: a count before each face's corners."""

    points = VERTICES
    faces = np.insert(FACES, 0, 3, axis=1).ravel()

    def triangulate(self) -> PolyData:
        return self


class Volume:
    """PyVista's volume meshes have no faces of their own."""

    points = VERTICES

    def extract_surface(self) -> PolyData:
        return PolyData()


def meshio(*blocks: tuple[str, Any]) -> SimpleNamespace:
    """A mesh of meshio's layout."""
    return SimpleNamespace(points=VERTICES, cells=[SimpleNamespace(type=kind, data=data) for kind, data in blocks])


def tensor(values: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(cpu=lambda: SimpleNamespace(numpy=lambda: values))


FOREIGN: dict[str, Any] = {
    "pair": (VERTICES, FACES),
    "lists": [VERTICES.tolist(), FACES.tolist()],
    "tensors": (torch.from_numpy(VERTICES), torch.from_numpy(FACES)),
    "trimesh": trimesh.Trimesh(VERTICES, FACES, process=False),
    "scene": trimesh.Scene(trimesh.Trimesh(VERTICES, FACES, process=False)),
    "open3d": SimpleNamespace(vertices=VERTICES.tolist(), triangles=FACES.tolist()),
    "open3d tensors": SimpleNamespace(
        vertex=SimpleNamespace(positions=tensor(VERTICES)), triangle=SimpleNamespace(indices=tensor(FACES))
    ),
    "pyvista": PolyData(),
    "pyvista volume": Volume(),
    "meshio": meshio(("line", np.array([[0, 1]])), ("triangle", FACES[:5]), ("triangle", FACES[5:])),
}


@pytest.mark.parametrize("kind", [*FOREIGN, "path", "str"])
def test_every_function_takes_every_kind(kind, tmp_path):
    MESH.save(tmp_path / "cube.ply")
    foreign = {"path": tmp_path / "cube.ply", "str": str(tmp_path / "cube.ply")} | FOREIGN
    mesh = foreign[kind]
    values = sdm.signed_distance_map(MESH, GRID, device="cpu").values
    assert torch.equal(sdm.signed_distance_map(mesh, GRID, device="cpu").values, values)
    assert torch.equal(sdm.MeshIndex(mesh, "cpu").signed_distance_map(GRID).values, values)
    assert torch.equal(sdm.signed_distance_maps([mesh, MESH], GRID, device="cpu")[0].values, values)
    assert sdm.signed_distance(mesh, POINTS, device="cpu").tolist() == [-1, 1]
    assert sdm.inspect_mesh(mesh).closed
    assert sdm.Grid.around(mesh, 8) == sdm.Grid.around(MESH, resolution=8)


def test_a_mesh_is_itself():
    assert as_mesh(MESH) is MESH


def test_quads_are_cut():
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5]])
    assert len(as_mesh(meshio(("quad", quads)))) == 4


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (None, "NoneType is no mesh: give a TriangleMesh, the path of a mesh file"),
        (3, "int is no mesh"),
        (VERTICES, "ndarray is no mesh"),
        ((VERTICES, FACES, FACES), "tuple of 3 is no mesh"),
        ((VERTICES,), "tuple of 1 is no mesh"),
        ("none.ply", "there is no mesh file none.ply"),
        ((VERTICES, FACES[:, :2]), r"\(12, 2\); \(F, 3\) is needed"),
        (meshio(("tetra", np.zeros((1, 4)))), "no triangles, but tetra: extract its surface"),
        (meshio(("triangle6", np.zeros((1, 6)))), "triangle6: only triangles and quads"),
    ],
)
def test_what_is_no_mesh(mesh, message):
    calls = [
        lambda: sdm.signed_distance_map(mesh, GRID),
        lambda: sdm.signed_distance(mesh, POINTS),
        lambda: sdm.MeshIndex(mesh),
        lambda: sdm.inspect_mesh(mesh),
        lambda: sdm.Grid.around(mesh),
    ]
    for call in calls:
        with pytest.raises(sdm.MeshError, match=message):
            call()
