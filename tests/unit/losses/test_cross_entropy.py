from __future__ import annotations

import math

import pytest
import torch

from sdm.errors import SDMError
from sdm.losses import cross_entropy_loss


def voxels(*rows) -> torch.Tensor:
    """Each row is a channel."""
    return torch.tensor(rows).reshape(1, len(rows), -1, 1, 1)


# Probabilities of the foreground: 0.8, 0.25.
LOGITS = voxels([math.log(4.0), -math.log(3.0)])


def test_by_hand():
    assert cross_entropy_loss(LOGITS, voxels([1, 0])).item() == pytest.approx(-(math.log(0.8) + math.log(0.75)) / 2)


def test_weights_by_hand():
    loss = cross_entropy_loss(LOGITS, voxels([1, 0]), weight=torch.tensor([1.0, 3.0]))
    assert loss.item() == pytest.approx(-(3 * math.log(0.8) + math.log(0.75)) / 4)


@pytest.mark.parametrize("weight", [None, torch.tensor([1.0, 3.0])])
def test_two_channels_are_the_same(weight):
    two = torch.cat([torch.zeros_like(LOGITS), LOGITS], 1)
    target = voxels([0, 1])
    torch.testing.assert_close(
        cross_entropy_loss(two, target, weight=weight), cross_entropy_loss(LOGITS, target, weight=weight)
    )


def test_classes_by_hand():
    logits = voxels([0.0, 0.0], [math.log(2.0), 0.0], [0.0, math.log(6.0)])
    assert cross_entropy_loss(logits, voxels([1, 0])).item() == pytest.approx((math.log(2.0) + math.log(8.0)) / 2)


def test_certain_and_wrong_is_finite():
    assert cross_entropy_loss(voxels([1e4]), voxels([0])).item() == pytest.approx(1e4)


def test_bad_input():
    two = torch.zeros(1, 2, 3, 3, 3)
    with pytest.raises(SDMError, match="one channel"):
        cross_entropy_loss(two, torch.zeros(1, 2, 3, 3, 3))
    with pytest.raises(SDMError, match="2 classes"):
        cross_entropy_loss(two, torch.zeros(1, 1, 3, 3, 3), weight=torch.ones(3))
