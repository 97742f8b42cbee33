"""Surface distances against every pair of surface voxels, in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_erosion

from sdm.errors import GridError, SDMError
from sdm.metrics import (
    average_surface_distance,
    hausdorff_distance,
    rms_surface_distance,
    surface_distances,
    surface_voxels,
)


def masks(seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    shape = random.integers(1, 9, 3)
    pair = random.random(shape) < 0.5, random.random(shape) < 0.2
    for mask in pair:
        mask[tuple(random.integers(0, shape))] = True
    return pair


def pairs(prediction: np.ndarray, truth: np.ndarray, spacing: tuple[float, ...]) -> list[np.ndarray]:
    p, t = (np.argwhere(m & ~binary_erosion(m)) * spacing for m in (prediction, truth))
    distance = np.linalg.norm(p[:, None] - t[None], axis=-1)
    return [distance.min(1), distance.min(0)]


@pytest.mark.parametrize("seed", range(20))
def test_against_every_pair(seed):
    spacing = (1.0, 1.0, 1.0) if seed % 2 else (0.4, 1.3, 3.0)
    prediction, truth = masks(seed)
    expected = pairs(prediction, truth, spacing)
    there = torch.tensor(prediction), torch.tensor(truth), spacing
    for found, wanted in zip(surface_distances(*there), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
    both = np.concatenate(expected)
    assert average_surface_distance(*there) == pytest.approx(both.mean(), rel=1e-6)
    assert rms_surface_distance(*there) == pytest.approx(np.sqrt((both**2).mean()), rel=1e-6)
    for percentile in (0, 50, 95, 100):
        wanted = max(np.percentile(d, percentile) for d in expected)
        assert hausdorff_distance(*there, percentile) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_surface_voxels(seed):
    mask = np.random.default_rng(seed).random((6, 7, 8)) < 0.9
    assert np.array_equal(surface_voxels(torch.tensor(mask)), mask & ~binary_erosion(mask))


def test_planes_by_hand():
    """Two plates, 2 apart in voxels of 1.5 mm."""
    prediction, truth = torch.zeros(6, 4, 4), torch.zeros(6, 4, 4)
    prediction[1], truth[3] = 1, 1
    arguments = (prediction, truth, (1.5, 0.7, 0.7))
    assert average_surface_distance(*arguments) == 3
    assert rms_surface_distance(*arguments) == 3
    assert hausdorff_distance(*arguments) == 3


def test_bad_input():
    mask = torch.ones(3, 3, 3)
    with pytest.raises(SDMError, match="percentile"):
        hausdorff_distance(mask, mask, 1.0, 101)
    with pytest.raises(GridError, match="spacing"):
        average_surface_distance(mask, mask, (1, 1, 0))
