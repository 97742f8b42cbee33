from __future__ import annotations

import pytest
import torch

from sdm.losses import dice_loss

P = torch.tensor([[0.5, 1.0, 0.0], [0.2, 0.0, 0.8]]).reshape(2, 1, 3, 1, 1)
G = torch.tensor([[1.0, 1, 0], [0, 0, 1]]).reshape(2, 1, 3, 1, 1)


def test_by_hand():
    # 2 * 1.5 / (1.5 + 2) and 2 * 0.8 / (1 + 1)
    assert dice_loss(P, G, smooth=0.0).item() == pytest.approx(1 - (3 / 3.5 + 0.8) / 2)


def test_squared_by_hand():
    # 2 * 1.5 / (1.25 + 2) and 2 * 0.8 / (0.68 + 1)
    assert dice_loss(P, G, squared=True, smooth=0.0).item() == pytest.approx(1 - (3 / 3.25 + 1.6 / 1.68) / 2)
    whole = dice_loss(P, G, squared=True, per_sample=False, smooth=0.0)
    assert whole.item() == pytest.approx(1 - 4.6 / (1.25 + 2 + 0.68 + 1), rel=1e-5)


def test_an_answer_where_nothing_is():
    assert dice_loss(P, torch.zeros_like(G)).item() == pytest.approx(1, abs=1e-4)
    assert dice_loss(torch.zeros_like(P), torch.zeros_like(G)).item() == 0
