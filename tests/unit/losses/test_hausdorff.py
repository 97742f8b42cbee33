from __future__ import annotations

import torch

from sdm.losses import hausdorff_distance_loss


def row(*values: float) -> torch.Tensor:
    return torch.tensor(values).reshape(1, 1, -1, 1, 1)


TARGET = row(0, 0, 1, 1, 0)
P = row(0.6, 0.2, 0.9, 0.5, 0.3)  # above 0.5: 1 0 1 0 0


def test_by_hand():
    # Prediction: 1 from the other class, everywhere but at the end. Target: 2 1 1 1 1.
    squares = torch.tensor([0.6, 0.2, 0.1, 0.5, 0.3]) ** 2
    weight = torch.tensor([1.0, 1, 1, 1, 2]) ** 2 + torch.tensor([2.0, 1, 1, 1, 1]) ** 2
    torch.testing.assert_close(hausdorff_distance_loss(P, TARGET), (squares * weight).mean())
    torch.testing.assert_close(hausdorff_distance_loss(P, TARGET, 3.0), 9 * (squares * weight).mean())


def test_foreground_alone_by_hand():
    squares = torch.tensor([0.6, 0.2, 0.1, 0.5, 0.3]) ** 2
    weight = torch.tensor([1.0, 0, 1, 0, 0]) + torch.tensor([0.0, 0, 1, 1, 0])
    torch.testing.assert_close(hausdorff_distance_loss(P, TARGET, foreground_only=True), (squares * weight).mean())


def test_other_powers():
    one = hausdorff_distance_loss(P, TARGET, power=1.0)
    squares = torch.tensor([0.6, 0.2, 0.1, 0.5, 0.3]) ** 2
    torch.testing.assert_close(one, (squares * torch.tensor([3.0, 2, 2, 2, 3])).mean())


def test_a_far_false_positive_costs_more_with_both_sides():
    def ratio(foreground_only: bool) -> float:
        target = torch.zeros(1, 1, 20, 1, 1)
        target[:, :, 2:6] = 1
        near, far = target.clone(), target.clone()
        near[:, :, 7:9] = 1
        far[:, :, 17:19] = 1
        options = {"foreground_only": foreground_only}
        return float(hausdorff_distance_loss(far, target, **options) / hausdorff_distance_loss(near, target, **options))

    assert ratio(foreground_only=False) > 10
    assert ratio(foreground_only=True) == 1
