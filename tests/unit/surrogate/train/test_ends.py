"""Samples towards the ends of the box, and the loss that stands for the Dice coefficient."""

from __future__ import annotations

import torch

from sdm.shapes import Cochlea
from sdm.stream import SDMStream
from sdm.stream.held_out import is_held_out
from sdm.surrogate.networks.cochlea_grid import GRID
from sdm.surrogate.train.end_sampler import Ends
from sdm.surrogate.train.losses import dice_lost, flips


def unit_values(count: int) -> torch.Tensor:
    family = Cochlea()
    theta = family.check(Ends().theta(family, 0, torch.arange(count)))
    low = torch.tensor([p.low for p in family.parameters])
    high = torch.tensor([p.high for p in family.parameters])
    assert not bool(((theta == low) | (theta == high)).all(1).any())
    assert not bool(is_held_out(theta).any())
    return (theta - low) / (high - low)


def test_samples_are_dense_at_the_ends_and_none_is_a_corner():
    unit = unit_values(8000)
    near = torch.minimum(unit, 1 - unit) < 0.05
    assert 0.3 < near.float().mean() < 0.5
    assert near.all(1).float().mean() > 0.02
    small = (unit[:, 0] < 0.05) & (unit[:, 2] > 0.95)
    assert small.float().mean() > 0.04
    crowded = (unit[:, 0] < 0.05) & (unit[:, 1] > 0.95) & ((unit[:, 2] - 0.5).abs() < 0.3)
    assert crowded.float().mean() > 0.015
    # All of the box has some.
    assert ((unit > 0.3) & (unit < 0.7)).all(1).any()


def test_a_stream_takes_it():
    batch = next(iter(SDMStream(Cochlea(500), Cochlea(500).grid(12), 4, seed=0, sampler=Ends(), device="cpu")))
    assert batch.sdm.shape == (4, 1, 12, 12, 12)


def test_dice_lost_is_the_volume_between_the_surfaces():
    place = GRID.points().to(torch.float32)
    middle = torch.tensor([0.037, 0.061, 0.813])

    def ball(radius: float) -> torch.Tensor:
        return ((place - middle).norm(dim=-1) - radius)[None, None]

    exact = torch.cat([ball(1.5), ball(2.5)])
    found = torch.cat([ball(1.53), ball(2.46)])
    # Of the volume between them, half as a share of the ball's: 3 d / (2 r). Voxels are too few to count it by.
    wanted = torch.tensor([3 * 0.03 / (2 * 1.5), 3 * 0.04 / (2 * 2.5)])
    torch.testing.assert_close(dice_lost(found, exact), wanted, rtol=0.1, atol=0)
    assert torch.equal(dice_lost(exact, exact), torch.zeros(2))


def test_flips_counts_voxels_on_the_wrong_side():
    exact = torch.full((2, 1, 4, 4, 4), 0.5)
    exact[:, :, :2, :2, :2] = -0.5
    found = exact.clone()
    found[0, 0, 3, 3, 3] = -0.1
    # One of eight inside has a twin outside; 1 - Dice is 1 / 17, by the volume of the exact inside alone 1 / 16.
    torch.testing.assert_close(flips(found, exact), torch.tensor([1 / 16, 0.0]))


def test_voxels_on_the_surface_are_outside():
    exact = torch.full((1, 1, 2, 2, 2), 0.0)
    exact[0, 0, 0] = -0.3
    found = exact.clone().requires_grad_()
    (slope,) = torch.autograd.grad(flips(found, exact).sum(), found)
    # A step down the slope moves the four on the surface outward.
    assert (slope[0, 0, 1] < -1).all()
    assert slope[0, 0, 0].abs().max() < 1e-3
