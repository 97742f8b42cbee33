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


def test_one_of_three_inside_out_is_named_and_turned():
    mesh = balls((2, ZERO, True), (1, FAR, False), (1, (0.0, 7.0, 0.0), True))
    report = inspect_mesh(mesh)
    assert (report.outward, report.inside_out, report.inside_out_components, report.components) == (False, False, 1, 3)
    assert "1 of 3 components is inside out" in report.problems[0]
    assert "--orient auto" in report.problems[0]
    turned = orient_outward(mesh)
    assert inspect_mesh(turned).problems == []
    assert (turned.faces != mesh.faces).any(1).sum() == len(BALL.faces)


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


def test_two_equal_balls_of_which_one_is_reversed_do_not_enclose_nothing():
    mesh = balls((1, ZERO, True), (1, FAR, False))
    assert "1 of 2 components is inside out" in inspect_mesh(mesh).problems[0]
    assert inspect_mesh(orient_outward(mesh)).problems == []


def test_what_is_inside_a_part_turns_with_it():
    mesh = balls((3, ZERO, False), (2, ZERO, True), (1, ZERO, False), (1, FAR, True))
    turned = orient_outward(mesh)
    report = inspect_mesh(turned)
    assert report.problems == []
    wanted = balls((3, ZERO, True), (2, ZERO, False), (1, ZERO, True), (1, FAR, True))
    assert report.volume == pytest.approx(inspect_mesh(wanted).volume)


def test_nearly_closed_meshes_are_turned():
    ball = balls((1, ZERO, False))
    mesh = TriangleMesh(ball.vertices, ball.faces[1:])
    report = inspect_mesh(mesh)
    assert report.inside_out
    assert "the mesh is inside out: its faces look inward" in report.problems[0]
    turned = orient_outward(mesh)
    assert orient_outward(turned) is turned
    assert inspect_mesh(turned).sign_problems == []
    assert torch.equal(turned.faces, mesh.faces.flip(1))


def test_a_box_without_its_lid_is_turned_and_a_bowl_is_not():
    box = trimesh.creation.box()
    lid = (box.vertices[box.faces][:, :, 2] > 0.4).all(1)
    assert lid.sum() == 2
    faces = box.faces[~lid][:, ::-1]
    assert orient_outward(TriangleMesh(box.vertices, faces)).faces.flip(1).tolist() == faces.tolist()
    for faces in (BALL.faces, BALL.faces[:, ::-1]):
        bowl = TriangleMesh(BALL.vertices, faces[(BALL.vertices[faces][:, :, 2] < 0.1).all(1)])
        assert orient_outward(bowl) is bowl
        assert inspect_mesh(bowl).sign_problems == []


def test_sheets_are_left_alone():
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0), indexing="ij")
    vertices = np.stack([x, y, 0.3 * np.sin(x + 2 * y)], -1).reshape(-1, 3)
    corner = (6 * np.arange(5)[:, None] + np.arange(5)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(three) for three in ([0, 6, 1], [1, 6, 7])])
    for sheet in (faces, faces[:, ::-1]):
        mesh = TriangleMesh(vertices, sheet)
        assert orient_outward(mesh) is mesh
        assert inspect_mesh(mesh).sign_problems == []


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_faces_flipped_at_random_are_made_to_agree(share):
    ball = trimesh.creation.icosphere(3)
    flip = np.random.default_rng(0).random(len(ball.faces)) < share
    mesh = TriangleMesh(ball.vertices, np.where(flip[:, None], ball.faces[:, ::-1], ball.faces))
    report = inspect_mesh(mesh)
    assert report.disagreeing_pairs > 0
    assert f"faces disagree which side is out along {report.disagreeing_edges:,} edges" in report.sign_problems[0]
    assert "not to be trusted" in report.sign_problems[0]
    turned = orient_outward(mesh)
    assert inspect_mesh(turned).problems == []
    assert inspect_mesh(turned).volume == pytest.approx(ball.volume, rel=1e-5)


def test_flipped_faces_of_loose_triangles_are_made_to_agree():
    flip = np.arange(len(BALL.faces)) % 3 == 0
    corners = BALL.vertices[np.where(flip[:, None], BALL.faces[:, ::-1], BALL.faces)].reshape(-1, 3)
    mesh = TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3))
    assert inspect_mesh(orient_outward(mesh)).problems == []


def test_flipped_faces_of_a_cavity_keep_it_a_cavity():
    mesh = balls((3, ZERO, True), (1, ZERO, False))
    faces = mesh.faces.clone()
    faces[len(BALL.faces) + 3] = faces[len(BALL.faces) + 3].flip(0)
    turned = orient_outward(TriangleMesh(mesh.vertices, faces))
    assert torch.equal(turned.faces.sort(1)[0], mesh.faces.sort(1)[0])
    assert inspect_mesh(turned).problems == []


def test_a_moebius_strip_is_left_alone_and_named():
    count = 12
    at = 2 * np.pi * np.arange(count) / count
    across = np.stack([np.cos(at / 2) * np.cos(at), np.cos(at / 2) * np.sin(at), np.sin(at / 2)], 1)
    middle = np.stack([np.cos(at), np.sin(at), 0 * at], 1)
    vertices = np.concatenate([middle - 0.3 * across, middle + 0.3 * across])
    i = np.arange(count)
    following = (i + 1) % count
    # At the seam the two sides change places.
    low, high = np.where(i == count - 1, count, following), np.where(i == count - 1, 0, count + following)
    faces = np.concatenate([np.stack([i, low, count + i], 1), np.stack([low, high, count + i], 1)])
    mesh = TriangleMesh(vertices, faces)
    report = inspect_mesh(mesh)
    assert report.disagreeing_pairs > 0
    assert "no turn of patches makes them agree" in report.sign_problems[0]
    assert "orient=" not in report.sign_problems[0]
    assert orient_outward(mesh) is mesh


def test_a_part_that_overlaps_another_is_outward_by_itself():
    mesh = balls((1, ZERO, True), (1, (0.9, 0.1, 0.2), False))
    assert inspect_mesh(mesh).inside_out_components == 1
    assert inspect_mesh(orient_outward(mesh)).sign_problems == []


def test_copies_of_a_face_do_not_disagree():
    twice = TriangleMesh(BALL.vertices[BALL.faces[0]], np.array([[0, 1, 2], [1, 2, 0], [0, 1, 2]]))
    assert inspect_mesh(twice).disagreeing_edges == 0
    assert inspect_mesh(twice).sign_problems == []


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
    from sdm.inspect import nesting

    monkeypatch.setattr(nesting, "MOST_SOLID_ANGLES", 1300)
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
