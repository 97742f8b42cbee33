"""Closest points beside a map: what they are asked for, and what follows from one gather."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, load_case, sphere
from sdm.engine import closest_points


@pytest.fixture
def ball():
    return sdm.TriangleMesh(*sphere(16))


def test_function_and_index_give_the_same(ball):
    field, hit = sdm.signed_distance_map(ball, 12, device="cpu", return_closest=True)
    index = sdm.MeshIndex(ball, "cpu")
    again, other = index.signed_distance_map(12, return_closest=True)
    assert isinstance(field, sdm.SDM)
    assert torch.equal(field.values, again.values)
    assert torch.equal(hit.points, other.points)
    assert torch.equal(hit.faces, other.faces)
    assert torch.equal(field.values, sdm.signed_distance_map(ball, 12, device="cpu").values)


def test_directions_lead_from_the_surface(ball):
    field, hit = sdm.signed_distance_map(ball, 12, device="cpu", return_closest=True)
    led = hit.points + hit.directions * field.values.abs()[..., None]
    torch.testing.assert_close(led, field.grid.points(), atol=2e-6, rtol=0)
    # Zero on the surface: at a vertex.
    values, there = sdm.signed_distance(ball, ball.vertices[:1].numpy(), return_closest=True, device="cpu")
    assert values.abs().item() == 0
    assert there.directions.tolist() == [[0, 0, 0]]


def test_directions_of_tiny_and_huge_meshes(ball):
    for scale in (1e-30, 1e29):
        mesh = sdm.TriangleMesh(ball.vertices * scale, ball.faces)
        _, hit = sdm.signed_distance_map(mesh, 6, device="cpu", return_closest=True)
        torch.testing.assert_close(hit.directions.norm(dim=-1), torch.ones(6, 6, 6))


def test_coordinates_of_the_vertices_interpolate_to_the_points(ball):
    for _, hit in (
        sdm.signed_distance_map(ball, 12, device="cpu", return_closest=True),
        sdm.signed_distance(ball, np.random.default_rng(0).normal(size=(5, 7, 3)), return_closest=True, device="cpu"),
    ):
        torch.testing.assert_close(hit.interpolate(ball.vertices), hit.points, atol=1e-6, rtol=0)
        heights = hit.interpolate(ball.vertices.numpy()[:, 2].astype(np.float64))
        assert heights.dtype == torch.float64
        torch.testing.assert_close(heights, hit.points[..., 2].double(), atol=1e-6, rtol=0)
        assert hit.interpolate(np.arange(ball.vertices.shape[0])).dtype == torch.float32


def test_gathered_in_chunks(ball, monkeypatch):
    _, hit = sdm.signed_distance_map(ball, 12, device="cpu", return_closest=True)
    labels = torch.arange(len(ball))
    whole = hit.interpolate(ball.vertices), hit.of_faces(labels)
    monkeypatch.setattr(closest_points, "CHUNK", 100)
    assert torch.equal(hit.interpolate(ball.vertices), whole[0])
    assert torch.equal(hit.of_faces(labels), whole[1])
    assert torch.equal(whole[1], hit.faces.long())


def test_labels_and_normals_of_a_cube():
    vertices, faces = cube()
    mesh = sdm.TriangleMesh(vertices, faces)
    field, hit = sdm.signed_distance_map(
        mesh, sdm.Grid((-2, -2, -2), (0.5, 0.5, 0.5), (9, 9, 9)), device="cpu", return_closest=True
    )
    corner = torch.from_numpy(vertices)[torch.from_numpy(faces).long()]
    normals = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    outward = (hit.of_faces(normals) * hit.directions).sum(-1)
    off = field.values.abs() > 1e-6
    assert ((outward > 0) == (field.values > 0))[off].all()


def test_points_that_are_not_finite(ball):
    _, hit = sdm.signed_distance(ball, [[np.nan, 0, 0], [2, 0, 0]], return_closest=True, device="cpu")
    assert hit.interpolate(ball.vertices).isnan().any(-1).tolist() == [True, False]
    assert hit.of_faces(torch.full((len(ball),), 7), missing=-1).tolist() == [-1, 7]
    assert hit.directions.isnan().any(-1).tolist() == [True, False]


def test_gradients_flow_to_values_of_vertices(ball):
    values = torch.zeros(ball.vertices.shape[0], requires_grad=True)
    _, hit = sdm.signed_distance_map(ball, 8, device="cpu", return_closest=True)
    hit.interpolate(values).sum().backward()
    assert values.grad is not None
    torch.testing.assert_close(values.grad.sum(), torch.tensor(512.0), atol=1e-3, rtol=0)


def test_gradients_of_the_map_are_as_without(ball):
    grads = []
    for wanted in (False, True):
        vertices = ball.vertices.clone().requires_grad_()
        found = sdm.signed_distance_map(sdm.TriangleMesh(vertices, ball.faces), 8, device="cpu", return_closest=wanted)
        field = found[0] if isinstance(found, tuple) else found
        if isinstance(found, tuple):
            assert not found[1].points.requires_grad
        field.values.sum().backward()
        grads.append(vertices.grad)
    assert torch.equal(*grads)


def test_faces_of_copies_are_the_meshs_own():
    """Triangles that a mesh has many times are measured once; numbers are those of the whole mesh."""
    case = load_case("cube")
    mesh = sdm.TriangleMesh(case.vertices, np.concatenate([case.faces[:1]] * 100 + [case.faces[1:]]))
    index = sdm.MeshIndex(mesh, "cpu", warn=False)
    assert index._repeated is not None
    field, hit = index.signed_distance_map(sdm.Grid.around(mesh, 10), return_closest=True)
    assert torch.equal(field.values, index.signed_distance_map(field.grid).values)
    assert set(hit.faces.unique().tolist()) <= {0, *range(100, 111)}
    _, by_points = index.signed_distance(field.grid.points(), return_closest=True)
    torch.testing.assert_close(by_points.interpolate(mesh.vertices), by_points.points, atol=1e-6, rtol=0)
    torch.testing.assert_close(hit.interpolate(mesh.vertices), hit.points, atol=1e-6, rtol=0)


def test_values_that_do_not_fit(ball):
    _, hit = sdm.signed_distance_map(ball, 4, device="cpu", return_closest=True)
    with pytest.raises(sdm.MeshError, match=r"not one for each of the mesh's \d+ vertices"):
        hit.interpolate(torch.zeros(3))
    with pytest.raises(sdm.MeshError, match=r"not one for each of the mesh's \d+ faces"):
        hit.of_faces(torch.zeros(3))
    made = closest_points.Closest(hit.points, hit.faces, hit.barycentric)
    for ask in (lambda: made.directions, lambda: made.interpolate(ball.vertices), lambda: made.of_faces(ball.faces)):
        with pytest.raises(sdm.MeshError, match="made by hand"):
            ask()
