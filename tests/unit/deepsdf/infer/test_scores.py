"""Scores of surfaces whose distance is known."""

from __future__ import annotations

import pytest
import torch
import trimesh

from sdm import TriangleMesh
from sdm.deepsdf import chamfer_distance, score_shape
from sdm.deepsdf.samples import UnitSphere


def ball(radius: float) -> TriangleMesh:
    made = trimesh.creation.icosphere(4, radius)
    return TriangleMesh(made.vertices, made.faces)


def test_the_chamfer_distance_is_the_sum_of_both_mean_squares_times_1000() -> None:
    a = torch.tensor([[0.0, 0, 0], [1, 0, 0]])
    b = torch.tensor([[0.0, 0, 0.1]])
    assert chamfer_distance(a, b) == pytest.approx(1000 * ((0.01 + 1.01) / 2 + 0.01), rel=1e-6)


def test_balls_of_two_sizes() -> None:
    found = score_shape(ball(9.0), ball(10.0), sphere=UnitSphere((0.0, 0.0, 0.0), 20.0), points=5000, resolution=48)
    assert found.mean == pytest.approx(1.0, rel=5e-3)
    assert found.percentile95 == pytest.approx(1.0, rel=5e-3)
    assert found.chamfer_surface == pytest.approx(1000 * 2 * 0.05**2, rel=5e-3)
    # The truth's box is a cube with sides of 20.
    assert found.diagonal == pytest.approx(3**0.5, rel=1e-5)
    assert found.chamfer_paper == pytest.approx(found.chamfer / 3, rel=1e-5)
    assert found.chamfer_paper_floor == pytest.approx(found.chamfer_floor / 3, rel=1e-5)
    assert found.dice == pytest.approx(2 * 0.729 / 1.729, abs=1e-2)


def test_a_perfect_answer_scores_the_floor() -> None:
    """Two draws of n points from an area A: each nearest point is at a mean square of A / (pi n)."""
    found = score_shape(ball(0.5), ball(0.5), sphere=UnitSphere((0.0, 0.0, 0.0), 1.0), points=4000, resolution=32)
    expected = 1000 * 2 * (4 * torch.pi * 0.25) / (torch.pi * 4000)
    assert found.chamfer_floor == pytest.approx(expected, rel=0.05)
    assert found.chamfer == pytest.approx(found.chamfer_floor, rel=0.06)
    assert found.chamfer_surface < 1e-6
    assert found.mean < 1e-6
    assert found.dice == 1.0
