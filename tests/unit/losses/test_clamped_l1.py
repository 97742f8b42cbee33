from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.losses import clamped_l1_loss


def test_by_hand():
    p = torch.tensor([0.05, 0.5, -3.0, 0.2])
    y = torch.tensor([-0.02, 0.3, -0.05, -0.4])
    # 0.07, both beyond, 0.05, from end to end
    assert clamped_l1_loss(p, y).item() == pytest.approx((0.07 + 0 + 0.05 + 0.2) / 4)
    assert clamped_l1_loss(p, y, delta=10.0).item() == pytest.approx((0.07 + 0.2 + 2.95 + 0.6) / 4)


def test_no_gradient_beyond_delta():
    p = torch.tensor([0.05, 0.5], requires_grad=True)
    clamped_l1_loss(p, torch.zeros(2)).backward()
    assert p.grad is not None
    assert p.grad.tolist() == [0.5, 0.0]


def test_delta_must_be_positive():
    with pytest.raises(SDMError, match="delta"):
        clamped_l1_loss(torch.zeros(1), torch.zeros(1), delta=0.0)
