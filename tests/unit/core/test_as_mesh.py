"""Whatever stands for a mesh is taken by every public function that wants one, or refused in one sentence."""

from __future__ import annotations

import sys
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


def surface_mesh(vertices: Any, faces: Any) -> SimpleNamespace:
    """Kaolin's layout: one mesh, a batch with shared faces, or lists."""
    return SimpleNamespace(vertices=vertices, faces=faces, batching=None)


class Meshes:
    """PyTorch3D's layout: a batch of meshes that differ."""

    def __init__(self, meshes: list[Any]) -> None:
        self.meshes = meshes

    def __len__(self) -> int:
        return len(self.meshes)

    def verts_list(self) -> list[torch.Tensor]:
        return [torch.from_numpy(mesh[0]) for mesh in self.meshes]

    def faces_list(self) -> list[torch.Tensor]:
        return [torch.from_numpy(mesh[1]) for mesh in self.meshes]


def meshlib(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """MeshLib's layout: arrays by functions of its own; one face was deleted."""
    valid = np.arange(len(FACES) + 1) != 3
    arrays = SimpleNamespace(
        getNumpyVerts=lambda mesh: mesh.points,
        getNumpyFaces=lambda topology: topology.faces,
        getNumpyBitSet=lambda bits: bits,
    )
    monkeypatch.setitem(sys.modules, "meshlib", SimpleNamespace(mrmeshnumpy=arrays))
    monkeypatch.setitem(sys.modules, "meshlib.mrmeshnumpy", arrays)
    topology = SimpleNamespace(faces=np.insert(FACES, 3, 0, axis=0), getValidFaces=lambda: valid)
    return SimpleNamespace(points=VERTICES, topology=topology)


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
    "pyvista blocks": SimpleNamespace(n_blocks=1, combine=Volume),
    "kaolin": surface_mesh(torch.from_numpy(VERTICES), torch.from_numpy(FACES)),
    "kaolin batch": surface_mesh(torch.from_numpy(VERTICES)[None], torch.from_numpy(FACES)),
    "kaolin list": surface_mesh([torch.from_numpy(VERTICES)], [torch.from_numpy(FACES)]),
    "pytorch3d": Meshes([(VERTICES, FACES)]),
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


def test_of_meshlib(monkeypatch):
    assert torch.equal(as_mesh(meshlib(monkeypatch)).faces, MESH.faces)


@pytest.mark.parametrize(
    "batch",
    [
        Meshes([(VERTICES, FACES), (2 * VERTICES, FACES)]),
        surface_mesh(torch.from_numpy(np.stack([VERTICES, 2 * VERTICES])), torch.from_numpy(FACES)),
        surface_mesh([VERTICES, 2 * VERTICES], [FACES, FACES]),
    ],
    ids=["pytorch3d", "kaolin", "kaolin list"],
)
def test_batches_of_other_libraries_are_lists(batch):
    wanted = sdm.signed_distance_maps([(VERTICES, FACES), (2 * VERTICES, FACES)], 5, device="cpu")
    found = sdm.signed_distance_maps(batch, 5, device="cpu")
    assert [field.grid for field in found] == [field.grid for field in wanted]
    assert sdm.signed_distances(batch, [POINTS, POINTS], device="cpu")[1].tolist() == [-2, 0]
    with pytest.raises(sdm.MeshError, match=r"of 2 meshes is not one: give one of them, or a list"):
        sdm.signed_distance_map(batch, 5)


def test_gradients_flow_to_tensors_of_other_libraries():
    vertices = torch.from_numpy(VERTICES).clone().requires_grad_()
    sdm.signed_distance(surface_mesh(vertices[None], torch.from_numpy(FACES)), POINTS, device="cpu").sum().backward()
    assert vertices.grad is not None
    assert float(vertices.grad.abs().sum()) > 0


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


def test_of_pyvista():
    pyvista = pytest.importorskip("pyvista")
    surface = pyvista.PolyData.from_regular_faces(VERTICES, FACES)
    for mesh in (surface, surface.cast_to_unstructured_grid(), pyvista.MultiBlock([surface])):
        assert sdm.signed_distance(mesh, POINTS, device="cpu").tolist() == [-1, 1]


def test_of_open3d():
    # Its wheel needs libraries of the system, without which it raises an ImportError of its own.
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    legacy = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(VERTICES), open3d.utility.Vector3iVector(FACES))
    for mesh in (legacy, open3d.t.geometry.TriangleMesh.from_legacy(legacy)):
        assert sdm.signed_distance(mesh, POINTS, device="cpu").tolist() == [-1, 1]


def test_of_meshio():
    mesh = pytest.importorskip("meshio").Mesh(VERTICES, [("triangle", FACES)])
    assert sdm.signed_distance(mesh, POINTS, device="cpu").tolist() == [-1, 1]


def test_of_meshlib_itself():
    arrays = pytest.importorskip("meshlib.mrmeshnumpy", exc_type=ImportError)
    mesh = arrays.meshFromFacesVerts(FACES.astype(np.int32), VERTICES.astype(np.float64))
    assert sdm.signed_distance(mesh, POINTS, device="cpu").tolist() == [-1, 1]
