"""An empty prediction is a failure, never perfect."""

from __future__ import annotations

import math

import pytest
import torch

from sdm.errors import SDMError
from sdm.metrics import evaluate_segmentation

EMPTY, FULL = torch.zeros(6, 7, 8).bool(), torch.ones(6, 7, 8).bool()
SOME = EMPTY.clone()
SOME[2:4, 2:5, 3:6] = True


@pytest.mark.parametrize(("prediction", "truth"), [(EMPTY, SOME), (SOME, EMPTY), (EMPTY, FULL), (FULL, EMPTY)])
def test_one_is_empty(prediction, truth):
    found = evaluate_segmentation(prediction, truth, 1.0)
    assert found.failed
    assert found.dice == found.jaccard == found.contour_dice == 0
    assert found.hausdorff95_mm == found.average_surface_distance_mm == found.rms_surface_distance_mm == math.inf


def test_both_are_empty():
    found = vars(evaluate_segmentation(EMPTY, EMPTY, 1.0))
    assert found.pop("failed") is False
    assert all(math.isnan(value) for value in found.values())


@pytest.mark.parametrize("mask", [SOME, FULL])
def test_perfect(mask):
    found = evaluate_segmentation(mask, mask, 1.0)
    assert not found.failed
    assert found.dice == found.jaccard == 1
    assert found.hausdorff95_mm == found.average_surface_distance_mm == found.rms_surface_distance_mm == 0
    assert found.contour_dice == 1 or mask is FULL


def test_layouts_and_types():
    found = evaluate_segmentation(SOME, SOME | EMPTY, 1.0)
    assert evaluate_segmentation(SOME[None, None].float(), SOME[None, None].to(torch.uint8), 1.0) == found


def test_bad_input():
    with pytest.raises(SDMError, match="same grid"):
        evaluate_segmentation(SOME, SOME[1:], 1.0)
    with pytest.raises(SDMError, match="one by one"):
        evaluate_segmentation(torch.stack([SOME, SOME]), torch.stack([SOME, SOME]), 1.0)
    with pytest.raises(SDMError, match="threshold"):
        evaluate_segmentation(0.3 * SOME, SOME, 1.0)
