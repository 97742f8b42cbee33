from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine import mesh_index, repeated_faces

BALL = trimesh.creation.icosphere(1)
GRID = Grid((-1.2, -1.1, -1.3), (0.3, 0.31, 0.29), (9, 9, 9))
ONE = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.9, 0.3]])
COPIES = 70


def meshes() -> dict[str, TriangleMesh]:
    rng = np.random.default_rng(0)
    some = np.concatenate([np.repeat(BALL.faces[:2], COPIES, 0), np.repeat(BALL.faces[1:2, ::-1], 30, 0), BALL.faces])
    shuffled = rng.permutation(some)
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    corners = np.concatenate([[[0, 0, 0]], np.eye(3)]) - 0.2
    return {
        "one triangle": TriangleMesh(ONE, np.repeat([[0, 1, 2]], COPIES, 0)),
        "loose": TriangleMesh(np.tile(ONE, (COPIES, 1)), np.arange(3 * COPIES).reshape(-1, 3)),
        "cancelling": TriangleMesh(ONE, np.concatenate([np.repeat([[0, 1, 2]], 60, 0), np.repeat([[1, 0, 2]], 60, 0)])),
        "of a ball": TriangleMesh(BALL.vertices, shuffled),
        "of an open ball": TriangleMesh(
            BALL.vertices, np.concatenate([np.repeat(BALL.faces[:1], 99, 0), BALL.faces[5:]])
        ),
        "closed": TriangleMesh(corners, np.repeat(tetrahedron, COPIES, 0)),
        "closed, inside out": TriangleMesh(corners, np.repeat(tetrahedron[:, ::-1], COPIES, 0)),
    }


@pytest.mark.parametrize("name", meshes())
def test_copies_measured_once_change_nothing(name, monkeypatch):
    mesh = meshes()[name]
    points = torch.from_numpy(np.random.default_rng(1).normal(size=(50, 3))).float()

    def found(merged):
        index = sdm.MeshIndex(mesh, "cpu")
        assert (index._repeated is not None) == merged
        values, hit = index.signed_distance(points, return_closest=True)
        field, whole = index.signed_distance_map(GRID), sdm.signed_distance_map(mesh, GRID, device="cpu")
        slabs = torch.cat([values for _, _, values in index.slabs(GRID, max_bytes=1)])
        assert torch.equal(field.values, whole.values)
        assert torch.equal(field.values, slabs)
        assert torch.equal(values, index.signed_distance(points))
        alone, hit_alone = sdm.signed_distance(mesh, points, return_closest=True, device="cpu")
        assert torch.equal(values, alone)
        assert torch.equal(values, sdm.signed_distance(mesh, points, device="cpu"))
        assert torch.equal(hit.faces, hit_alone.faces)
        assert field.ambiguous_voxels == whole.ambiguous_voxels
        return values, hit, index.winding_number(points), field

    values, hit, winding, field = found(True)
    monkeypatch.setattr(repeated_faces, "MOST_TRIANGLES", 0)
    plain_values, plain_hit, plain_winding, plain_field = found(False)
    torch.testing.assert_close(winding, plain_winding, rtol=1e-4, atol=1e-4)
    clear = (plain_winding - 0.5).abs() > 1e-3
    torch.testing.assert_close(values[clear], plain_values[clear])
    torch.testing.assert_close(field.values.abs(), plain_field.values.abs())
    assert ((field.values < 0) != (plain_field.values < 0)).sum() <= 0.01 * GRID.size
    # The smallest number of the copies.
    corners = np.unique(mesh.vertices.numpy(), axis=0, return_inverse=True)[1].reshape(-1)[mesh.faces]
    names = np.unique(np.sort(corners, 1), axis=0, return_inverse=True)[1].reshape(-1)
    first = np.array([np.flatnonzero(names == name)[0] for name in names])
    assert (first[hit.faces] == hit.faces.numpy()).all()
    near = (hit.points - plain_hit.points).norm(dim=1) < 1e-5
    assert near.float().mean() > 0.9


@pytest.mark.parametrize("name", meshes())
@pytest.mark.parametrize("hole_size", [None, 1.3])
def test_floods_see_the_same_holes_by_one_copy(name, hole_size, monkeypatch):
    mesh = meshes()[name]
    grid = Grid.around(mesh, 14, margin=0.3)
    found = sdm.signed_distance_map(mesh, grid, sign="flood", hole_size=hole_size, device="cpu").values
    monkeypatch.setattr(repeated_faces, "MOST_TRIANGLES", 0)
    plain = sdm.signed_distance_map(mesh, grid, sign="flood", hole_size=hole_size, device="cpu").values
    torch.testing.assert_close(found, plain)


def test_a_flood_of_very_many_copies_ends():
    """A walk along the rims of copies looked at each of them for each: of 100,000 that took half an hour."""
    faces = np.concatenate([BALL.faces[6:], np.repeat(BALL.faces[:3], 100_000, 0)])
    few = np.concatenate([BALL.faces[6:], BALL.faces[:3]])
    found, plain = (
        sdm.signed_distance_map(TriangleMesh(BALL.vertices, own), GRID, sign="flood", hole_size=2.0, device="cpu")
        for own in (faces, few)
    )
    assert torch.equal(found.values, plain.values)
    assert found.inside_voxels > 0


def test_gradients_of_copies():
    mesh = meshes()["of an open ball"]
    points = torch.tensor([[0.1, 0.2, 0.1], [2.0, 1.0, 0.0]], requires_grad=True)
    values = sdm.MeshIndex(mesh, "cpu").signed_distance(points)
    (gradient,) = torch.autograd.grad(values.sum(), points)
    torch.testing.assert_close(gradient.norm(dim=1), torch.ones(2))
    away = (points + 0.01 * gradient).detach()
    assert (sdm.MeshIndex(mesh, "cpu").signed_distance(away) > values).all()


def test_meshes_without_copies_are_left_alone():
    for subdivisions in (1, 2, 3):
        ball = trimesh.creation.icosphere(subdivisions)
        for faces in (ball.faces, ball.faces[1:], np.concatenate([ball.faces, ball.faces])):
            assert sdm.MeshIndex(TriangleMesh(ball.vertices, faces), "cpu")._repeated is None


def test_a_hundred_thousand_copies_are_one_triangle():
    mesh = TriangleMesh(ONE, np.repeat([[0, 1, 2]], 100_000, 0))
    index = sdm.MeshIndex(mesh, "cpu")
    assert len(index._measured) == 1
    assert index._structure.sizes.faces == 1
    assert index.winding_number([[0.4, 0.3, -5.0]]).abs().item() > 100


def test_points_without_an_index_see_one_triangle_too(monkeypatch):
    built = []

    def build(vertices, faces, edges=None):
        built.append(len(faces))
        return structure(vertices, faces, edges)

    structure = mesh_index.build
    monkeypatch.setattr(mesh_index, "build", build)
    vertices = torch.tensor(ONE, dtype=torch.float32, requires_grad=True)
    mesh = TriangleMesh(vertices, np.repeat([[0, 1, 2]], 100_000, 0))
    value = sdm.signed_distance(mesh, [[0.25, 0.25, 2.0]], device="cpu")
    assert built == [1]
    (gradient,) = torch.autograd.grad(value.sum(), vertices)
    assert gradient.abs().sum() > 0


@pytest.mark.gpu
@pytest.mark.parametrize("name", ["one triangle", "of a ball", "closed, inside out"])
def test_a_gpu_merges_copies_too(name, monkeypatch):
    monkeypatch.setattr(repeated_faces, "FEWEST_ON_GPU", 0)
    mesh = meshes()[name]
    found = [sdm.MeshIndex(mesh, device) for device in ("cpu", "cuda")]
    if len(mesh) >= repeated_faces.CROWDED * mesh.vertices.shape[0]:
        assert found[1]._repeated is not None
    host, gpu = (index.signed_distance_map(GRID) for index in found)
    torch.testing.assert_close(gpu.values.cpu(), host.values)
    assert gpu.ambiguous_voxels == host.ambiguous_voxels


@pytest.mark.gpu
@pytest.mark.parametrize("loose", [False, True])
def test_a_gpu_merges_a_hundred_thousand_copies(loose):
    faces = np.arange(300_000).reshape(-1, 3) if loose else np.repeat([[0, 1, 2]], 100_000, 0)
    mesh = TriangleMesh(np.tile(ONE, (100_000 if loose else 1, 1)), faces)
    index = sdm.MeshIndex(mesh, "cuda")
    assert index._repeated is not None
    one = sdm.signed_distance_map(TriangleMesh(ONE, [[0, 1, 2]]), GRID, device="cuda", sign="none")
    assert torch.equal(index.signed_distance_map(GRID).values.abs(), one.values)
