from __future__ import annotations

import math

import pytest
import torch

from sdm.errors import SDMError
from sdm.losses import clipped_sdf, inverse_weighted_mse_loss


def test_by_hand():
    p, y = torch.tensor([0.1, 0.5, -0.5]), torch.tensor([0.0, 1.0, -0.25])
    expected = (0.01 / 0.001 + 0.25 / 1.001 + 0.0625 / 0.251) / 3
    assert inverse_weighted_mse_loss(p, y).item() == pytest.approx(expected, rel=1e-6)


def test_target_by_hand():
    values = clipped_sdf(torch.tensor([-math.inf, -7.0, -2.5, 0.0, 1.0, math.inf]))
    torch.testing.assert_close(values, torch.tensor([-1.0, -1, -0.5, 0, 0.2, 1]))
    assert clipped_sdf(torch.tensor(1.0), 2.0) == 0.5


def test_what_must_be_positive():
    with pytest.raises(SDMError, match="epsilon"):
        inverse_weighted_mse_loss(torch.zeros(1), torch.zeros(1), epsilon=0)
    with pytest.raises(SDMError, match="clipping"):
        clipped_sdf(torch.zeros(1), 0)
