"""The measures of a surrogate's errors, on errors that are known."""

from __future__ import annotations

import pytest
import torch

from sdm.engine.many import signed_distance_maps
from sdm.shapes import Cochlea
from sdm.surrogate import GRID, measure
from sdm.surrogate.train.accuracy import crossings, interpolated

THETA = torch.tensor([[3.7, 0.45, 0.146, 0.6], [3.0, 0.2, 0.1, 0.0]])


def exact(theta: torch.Tensor) -> torch.Tensor:
    family = Cochlea()
    return signed_distance_maps(family.vertices(theta), family.faces, GRID, device="cpu")[:, None]


def test_exact_maps_have_no_errors_but_those_of_the_voxels():
    found = measure(exact, THETA, "cpu").summary()
    assert found["mae_mm"] == found["max_mm"] == found["mae_near_mm"] == 0
    assert found["dice_mean"] == found["dice_worst"] == 1
    assert 0 < found["surface_mean_mm"] < 0.01
    assert found["slope_error"] < 0.02


def test_a_surface_that_is_too_far_out_is_found():
    # One shape is right, the other is 0.05 mm too large all over, with one voxel that is far off.
    def wrong(theta):
        maps = exact(theta)
        maps[1] -= 0.05
        maps[1, 0, 0, 0, 0] -= 2
        return maps

    found = measure(wrong, THETA, "cpu")
    assert found.mae == pytest.approx([0, 0.05], abs=1e-4)
    assert found.mae_near == pytest.approx([0, 0.05], abs=1e-6)
    assert found.most == pytest.approx([0, 2.05], abs=1e-5)
    assert found.surface_mean[1] == pytest.approx(0.05, abs=0.01)
    assert 0.8 < found.dice[1] < 0.99
    assert found.summary()["dice_worst"] == found.dice[1]


def test_a_map_without_an_inside_is_infinitely_far():
    found = measure(lambda theta: exact(theta).abs() + 1, THETA[:1], "cpu")
    assert found.surface_mean == [float("inf")]
    assert found.dice == [0.0]


def test_places_on_the_grid():
    centres = GRID.points()
    plane = centres[..., 0] - 1.03
    points = crossings(plane)
    assert len(points) == GRID.shape[1] * GRID.shape[2]
    torch.testing.assert_close(points[:, 0], torch.full((len(points),), 1.03), atol=1e-5, rtol=0)
    at = torch.tensor([[0.123, 1.0, 2.0], [5.55, -3.2, 0.77]])
    slope = torch.tensor([0.3, -0.7, 0.2])
    torch.testing.assert_close(interpolated(centres @ slope, at), at @ slope, atol=1e-4, rtol=0)
