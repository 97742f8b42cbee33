"""Measures of the paper where the answer is known."""

from __future__ import annotations

import math

import pytest
import torch
import trimesh

from sdm import MeshIndex, TriangleMesh
from sdm.deepsdf import earth_movers_distance, score_shape
from sdm.deepsdf.infer.paper_measures import paper_measures


def ball(radius: float, *, inside_out: bool = False) -> MeshIndex:
    made = trimesh.creation.icosphere(4, radius)
    if inside_out:
        made.invert()
    return MeshIndex(TriangleMesh(made.vertices, made.faces), "cpu")


def test_earth_movers_distance_pairs_each_point_once() -> None:
    a = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    # Moved by 0.3 and shuffled; the nearest neighbours alone would pair two with one.
    assert earth_movers_distance(a, a[[2, 0, 1]] + torch.tensor([0.3, 0, 0])) == pytest.approx(0.3, rel=1e-6)
    # Both points of a are at the origin: one has to go to 4, though 1 is nearer to either.
    b = torch.tensor([[1.0, 0, 0], [0, 4, 0]])
    assert earth_movers_distance(torch.zeros(2, 3), b) == pytest.approx(2.5)


def test_concentric_balls() -> None:
    """Radii 1 and 1.1: every point is 0.1 away, and normals agree."""
    diagonal = 2.2 * math.sqrt(3)
    found = paper_measures(ball(1.0), ball(1.1), diagonal)
    assert found.accuracy == pytest.approx(0.1 / diagonal, rel=0.01)
    assert found.completion == 0.0
    assert found.normal_cosine == pytest.approx(1.0, abs=2e-3)
    # No pairing is shorter than the gap, and another draw from the truth is not paired for nothing.
    assert 0.1 / diagonal < found.emd < 0.1 / diagonal + 1.5 * found.emd_floor
    assert found.emd_floor > 0.01


def test_completion_counts_true_points_within_a_hundredth() -> None:
    near, far = 1.0 + 0.009 * 2 * math.sqrt(3), 1.0 + 0.012 * 2 * math.sqrt(3)
    diagonal = 2 * math.sqrt(3)
    assert paper_measures(ball(near), ball(1.0), diagonal).completion == 1.0
    assert paper_measures(ball(far), ball(1.0), diagonal).completion == 0.0


def test_half_a_ball_is_half_complete_and_all_accurate() -> None:
    made = trimesh.creation.icosphere(4, 1.0)
    half = made.faces[made.triangles_center[:, 2] > 0]
    found = paper_measures(MeshIndex(TriangleMesh(made.vertices, half), "cpu", warn=False), ball(1.0), 2 * math.sqrt(3))
    # Beside the half, a ring as wide as the limit.
    assert found.completion == pytest.approx(0.5 + 0.01 * math.sqrt(3), abs=0.04)
    assert found.accuracy < 1e-5


def test_normals_that_face_inward_count_against() -> None:
    assert paper_measures(ball(1.0, inside_out=True), ball(1.0), 1.0).normal_cosine == pytest.approx(-1.0, abs=2e-3)


def test_scores_of_a_shape_hold_them() -> None:
    truth = ball(5.0).mesh
    found = score_shape(truth, truth, points=2000, resolution=24)
    assert found.completion == 1.0
    assert found.accuracy < 1e-6
    assert found.emd == pytest.approx(found.emd_floor, rel=0.3)
