from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_dilation, binary_erosion

from sdm.errors import SDMError
from sdm.metrics import contour_dice


def test_by_hand():
    """A half space: the band is 2 voxels on both sides of its face, 16 voxels each."""
    truth, prediction = torch.zeros(12, 4, 4), torch.zeros(12, 4, 4)
    truth[:6] = 1
    prediction[:7] = 1
    assert contour_dice(prediction, truth) == 2 * 2 / (2 + 3)
    assert contour_dice(prediction, truth, width=3) == 2 * 1 / (1 + 2)
    prediction[10:] = 1
    assert contour_dice(prediction, truth) == 0.8


@pytest.mark.parametrize("seed", range(6))
def test_against_scipy(seed):
    index = np.indices((20, 18, 16)) - np.array([10, 9, 8])[:, None, None, None]
    truth = ((index / np.random.default_rng(seed).uniform(3, 8, 3)[:, None, None, None]) ** 2).sum(0) <= 1
    prediction = np.roll(truth, (1, -1, 1), (0, 1, 2))
    cube = np.ones((5, 5, 5))
    band = binary_dilation(truth, cube) & ~binary_erosion(truth, cube, border_value=1)
    expected = 2 * (prediction & truth & band).sum() / ((prediction & band).sum() + (truth & band).sum())
    assert contour_dice(torch.tensor(prediction), torch.tensor(truth)) == pytest.approx(expected)


@pytest.mark.parametrize("width", [0, 1, 4])
def test_widths_that_have_no_middle(width):
    with pytest.raises(SDMError, match="odd"):
        contour_dice(torch.ones(3, 3, 3), torch.ones(3, 3, 3), width)
