from __future__ import annotations

import pytest
import torch

from sdm.losses import boundary_loss

ROW = torch.tensor([0.0, 0, 1, 1, 0]).reshape(1, 1, 5, 1, 1)
P = torch.tensor([0.1, 0.2, 0.9, 0.5, 0.3]).reshape(1, 1, 5, 1, 1)


@pytest.mark.parametrize(
    ("surface", "phi"),
    [
        ("faces", [1.5, 0.5, -0.5, -0.5, 0.5]),
        ("centres", [2.0, 1, -1, -1, 1]),
        ("published", [2.0, 1, 0, 0, 1]),
    ],
)
def test_by_hand(surface, phi):
    expected = (P.flatten() * torch.tensor(phi)).mean()
    torch.testing.assert_close(boundary_loss(P, ROW, surface=surface), expected)


def test_in_the_unit_of_the_spacing():
    torch.testing.assert_close(boundary_loss(P, ROW, (3, 1, 1)), 3 * boundary_loss(P, ROW))


def test_a_known_map():
    assert boundary_loss(P, ROW, distance=2 * torch.ones_like(P)) == 2 * P.mean()


def test_the_truth_is_the_best_answer():
    for other in (P, 1 - ROW, torch.zeros_like(P), torch.ones_like(P)):
        assert boundary_loss(ROW, ROW) < boundary_loss(other, ROW)
