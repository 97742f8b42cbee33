"""Faces turned patch by patch: signs of the mesh as it was before its faces were mixed up."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError

BALL = trimesh.creation.icosphere(3)
CORNERS = np.asarray(BALL.vertices)
TORUS = trimesh.creation.torus(1, 0.4)


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    begins = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [faces + begin for (_, faces), begin in zip(parts, begins, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def bowl(at: float) -> tuple[np.ndarray, np.ndarray]:
    return CORNERS + np.array([at, 0, 0]), BALL.faces[BALL.triangles_center[:, 2] < 0.3]


def test_very_many_copies_of_faces_are_turned_with_a_few_of_them():
    """Each copy was a patch whose rays met all the others: of 20,000 copies of three faces that took many minutes."""
    for copies in (3, 4, 20_000, 20_001):
        mixed = np.concatenate([BALL.faces[:, ::-1], np.repeat(BALL.faces[:3, ::-1], copies, 0)])
        found = sdm.orient_faces(TriangleMesh(CORNERS, mixed), "cpu").faces.numpy()
        np.testing.assert_array_equal(found[:1280], BALL.faces)
        own = found[1280:].reshape(3, copies, 3)
        assert (own == own[:, :1]).all()
        assert (np.sort(own[:, 0]) == np.sort(BALL.faces[:3])).all()


OUTER, INNER = (BALL.vertices, BALL.faces), (0.5 * BALL.vertices, BALL.faces)
CAVITY = (INNER[0], INNER[1][:, ::-1])
MESHES = {
    "ball": OUTER,
    "torus": (TORUS.vertices, TORUS.faces),
    "cavity": joined(OUTER, CAVITY),
    "beside each other": joined(OUTER, (CORNERS + np.array([3.0, 0, 0]), BALL.faces)),
    "less a tenth": (BALL.vertices, BALL.faces[np.random.default_rng(3).random(1280) >= 0.1]),
    "wide open": bowl(0.0),
    "crossing": joined(OUTER, (CORNERS + np.array([0.7, 0, 0]), BALL.faces)),
}


def mixed(mesh: tuple[np.ndarray, np.ndarray], share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = mesh
    turn = np.random.default_rng(seed).random(len(faces)) < share
    return vertices, np.where(turn[:, None], np.asarray(faces)[:, ::-1], faces)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("share", [0.5, 0.1, 1.0])
def test_mixed_faces_give_the_signs_of_the_original(name, share, device):
    mesh = MESHES[name]
    expected = sdm.signed_distance_map(mesh, 20, device=device)
    found = sdm.signed_distance_map(mixed(mesh, share, 1), expected.grid, device=device, orient="parts")
    assert torch.equal(found.values < 0, expected.values < 0)
    assert torch.allclose(found.values, expected.values, rtol=0, atol=1e-6)


def test_a_mesh_that_faces_outward_is_left_alone(device):
    for name, (vertices, faces) in MESHES.items():
        mesh = sdm.TriangleMesh(vertices, faces).to(device)
        assert sdm.orient_faces(mesh) is mesh, name


def test_nested_shells_keep_their_meaning():
    solid, hollow = joined(OUTER, INNER), joined(OUTER, CAVITY)
    for vertices, faces in (solid, hollow):
        reversed_ = sdm.TriangleMesh(vertices, faces[:, ::-1].copy())
        assert np.array_equal(sdm.orient_faces(reversed_).faces.numpy(), faces)


def test_sheets_seen_from_both_sides_only_agree():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    for faces in ([[0, 1, 2], [0, 2, 3]], [[0, 2, 1], [0, 3, 2]]):
        mesh = sdm.TriangleMesh(square, faces)
        assert sdm.orient_faces(mesh) is mesh
    turned = sdm.orient_faces((square, [[0, 1, 2], [0, 3, 2]])).faces
    assert turned.tolist() in ([[0, 1, 2], [2, 3, 0]], [[2, 1, 0], [0, 3, 2]])


def test_panels_of_a_box_face_outward():
    box = trimesh.creation.box()
    vertices = np.asarray(box.triangles).reshape(-1, 3)
    faces = np.arange(36).reshape(-1, 3)
    apart = vertices + 0.02 * np.repeat(box.face_normals, 3, 0)
    found = sdm.orient_faces(mixed((apart, faces), 0.5, 0))
    assert np.array_equal(found.faces.numpy(), faces)


def test_one_sided_and_flat_faces_do_no_harm():
    turns = np.linspace(0, np.pi, 12, endpoint=False)
    middle = np.stack([np.cos(2 * turns), np.sin(2 * turns), 0 * turns], 1)
    wide = 0.3 * np.stack([np.cos(turns) * np.cos(2 * turns), np.cos(turns) * np.sin(2 * turns), np.sin(turns)], 1)
    vertices = np.concatenate([middle - wide, middle + wide])
    one = np.arange(12)
    other = (one + 1) % 12
    low, high = np.where(one == 11, 12, other), np.where(one == 11, 0, 12 + other)
    strip = np.concatenate([np.stack([one, low, 12 + one], 1), np.stack([low, high, 12 + one], 1)])
    assert len(sdm.orient_faces((vertices, strip))) == 24
    assert len(sdm.orient_faces((vertices, [[0, 0, 1], [0, 1, 2], [3, 3, 3]]))) == 3


def test_other_words_are_refused():
    with pytest.raises(MeshError, match="use 'keep', 'auto' or 'parts'"):
        sdm.signed_distance_map(OUTER, 8, orient="outward")  # pyright: ignore[reportArgumentType]


def test_the_warning_names_the_share_and_what_to_pass():
    with pytest.warns(
        sdm.SDMWarning, match=r"\d % of the area is turned against the rest.*--orient parts.*--sign flood"
    ):
        sdm.signed_distance_map(mixed(OUTER, 0.2, 0), 16)
    report = sdm.inspect_mesh(mixed(OUTER, 0.2, 0))
    assert report.turned_area == pytest.approx(0.2, abs=0.04)


def test_nothing_inside_a_thin_closed_mesh_is_said_at_once():
    plate = CORNERS * [1, 1, 1e-4] @ trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.4, 0.5]))[:3, :3]
    with pytest.warns(sdm.SDMWarning, match="nothing is inside although"):
        sdm.signed_distance_map((plate, BALL.faces), 18)
