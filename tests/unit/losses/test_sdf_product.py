from __future__ import annotations

import pytest
import torch

from sdm.losses import probability_from_sdf, sdf_product_loss

P, Y = torch.tensor([0.5, -1.0]), torch.tensor([1.0, -0.5])


def test_by_hand():
    # <y,p> = 1, <p,p> = <y,y> = 1.25, mean |y - p| = 0.5
    assert sdf_product_loss(P, Y, smooth=0.0).item() == pytest.approx(-1 / 3.5 + 0.5)
    assert sdf_product_loss(P, Y, smooth=0.5, l1_weight=2.0).item() == pytest.approx(-1.5 / 4 + 1.0)


def test_each_voxel_by_hand():
    p, y = torch.tensor([0.5, -1.0]), torch.tensor([1.0, 0.5])
    # 0.5 / (0.5 + 0.25 + 1) and -0.5 / (-0.5 + 1 + 0.25)
    expected = -(0.5 / 1.75 - 0.5 / 0.75) / 2 + 1.0
    assert sdf_product_loss(p, y, per_voxel=True, smooth=0.0).item() == pytest.approx(expected)


@pytest.mark.parametrize("per_voxel", [False, True])
def test_range(per_voxel):
    options = {"per_voxel": per_voxel, "l1_weight": 0.0}
    assert sdf_product_loss(Y, Y, **options).item() == pytest.approx(-1 / 3, abs=1e-4)
    assert sdf_product_loss(-Y, Y, **options).item() == pytest.approx(1, abs=1e-4)


def test_probability_is_a_step_that_is_one_inside():
    p = probability_from_sdf(torch.tensor([-1.0, -1 / 1500, 0.0, 1.0]))
    torch.testing.assert_close(p, torch.tensor([1.0, torch.sigmoid(torch.tensor(1.0)), 0.5, 0.0]))
