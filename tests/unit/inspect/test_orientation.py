from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from sdm.core.mesh import TriangleMesh
from sdm.inspect import inspect_mesh, orient_outward

BALL = trimesh.creation.icosphere(1)


def balls(*parts: tuple[float, tuple[float, float, float], bool]) -> TriangleMesh:
    """Balls of a radius, at a place, facing outward or not."""
    vertices = [BALL.vertices * radius + at for radius, at, _ in parts]
    faces = [
        (BALL.faces if out else BALL.faces[:, ::-1]) + i * len(BALL.vertices) for i, (_, _, out) in enumerate(parts)
    ]
    return TriangleMesh(np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.int32), "balls")


ZERO = (0.0, 0.0, 0.0)
FAR = (5.0, 0.0, 0.0)


def test_a_ball_inside_out_is_named_and_turned():
    mesh = balls((1, ZERO, False))
    report = inspect_mesh(mesh)
    assert (report.closed, report.oriented, report.outward, report.inside_out_components) == (True, True, False, 1)
    assert report.volume is not None
    assert report.volume < 0
    assert "inside out" in report.problems[0]
    assert "--orient auto" in report.problems[0]
    turned = orient_outward(mesh)
    assert inspect_mesh(turned).problems == []
    assert turned.vertices is mesh.vertices


@pytest.mark.parametrize(
    "parts",
    [
        [(1, ZERO, True)],
        [(2, ZERO, True), (1, ZERO, False)],  # a cavity
        [(3, ZERO, True), (2, ZERO, False), (1, ZERO, True)],  # a ball in a cavity
        [(1, ZERO, True), (1, FAR, True)],
        [(2, ZERO, True), (1, ZERO, True)],  # a ball in a ball is harmless
    ],
)
def test_what_faces_the_right_way_is_left_alone(parts):
    mesh = balls(*parts)
    report = inspect_mesh(mesh)
    assert report.outward is True
    assert report.inside_out_components == 0
    assert report.problems == []
    assert orient_outward(mesh) is mesh


def test_one_of_three_inside_out_is_named_and_left_alone():
    mesh = balls((2, ZERO, True), (1, FAR, False), (1, (0.0, 7.0, 0.0), True))
    report = inspect_mesh(mesh)
    assert (report.outward, report.inside_out_components, report.components) == (False, 1, 3)
    assert "1 of 3 components is inside out" in report.problems[0]
    assert orient_outward(mesh) is mesh


def test_a_shell_with_a_cavity_that_is_inside_out_as_a_whole():
    mesh = balls((2, ZERO, False), (1, ZERO, True))
    report = inspect_mesh(mesh)
    assert report.outward is False
    assert "the mesh is inside out" in report.problems[0]
    assert inspect_mesh(orient_outward(mesh)).problems == []


def test_a_closed_inside_out_part_of_an_open_mesh_is_named():
    mesh = balls((1, ZERO, True), (1, FAR, False))
    opened = TriangleMesh(mesh.vertices, mesh.faces[1:], "opened")
    report = inspect_mesh(opened)
    assert (report.closed, report.outward, report.inside_out_components) == (False, None, 1)
    assert any("1 of 2 components is inside out" in problem for problem in report.problems)


def test_open_meshes_are_never_turned():
    ball = balls((1, ZERO, False))
    mesh = TriangleMesh(ball.vertices, ball.faces[1:])
    assert orient_outward(mesh) is mesh


def test_far_from_zero():
    mesh = balls((1, (1e5, -1e5, 1e5), False))
    assert orient_outward(mesh) is not mesh
    assert orient_outward(orient_outward(mesh)) is not orient_outward(mesh)
    good = balls((1, (1e5, -1e5, 1e5), True))
    assert orient_outward(good) is good


def test_a_doubled_sheet_is_left_alone():
    rng = np.random.default_rng(1)
    sheet = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4]], np.int32)
    mesh = TriangleMesh(rng.normal(size=(5, 3)).astype(np.float32) + 10, np.concatenate([sheet, sheet[:, ::-1]]))
    assert orient_outward(mesh) is mesh


def test_gradients_still_reach_the_vertices():
    ball = balls((1, ZERO, False))
    mesh = TriangleMesh(ball.vertices.clone().requires_grad_(), ball.faces)
    assert orient_outward(mesh).vertices.requires_grad


def test_many_cavities_are_not_waited_for(monkeypatch):
    from sdm.inspect import orientation

    monkeypatch.setattr(orientation, "MOST_SOLID_ANGLES", 100)
    cavities = [(0.05, (x, 0.0, 0.0), False) for x in (-0.5, 0.0, 0.5)]
    report = inspect_mesh(balls((1, ZERO, True), *cavities))
    assert report.inside_out_components == 0
    assert "2 components facing inward could not be told" in report.problems[0]


def test_the_engine_agrees_about_inside(device):
    from sdm.engine.api import signed_distance

    at = torch.zeros(1, 3)
    mesh = balls((1, ZERO, False)).to(device)
    assert signed_distance(mesh, at.to(device)).item() > 0
    assert signed_distance(orient_outward(mesh), at.to(device)).item() < 0
