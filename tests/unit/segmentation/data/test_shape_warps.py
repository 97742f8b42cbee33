"""Displacements between shapes: they meet, do not fold, and can be undone."""

from __future__ import annotations

import torch

from sdm.segmentation.data.shape_warps import displacement, enlarged, moved, volumes, warped

SHAPE = (24, 22, 20)


def ball(centre, radius) -> torch.Tensor:
    place = torch.stack(torch.meshgrid(*(torch.arange(float(n)) for n in SHAPE), indexing="ij"), -1)
    return (place - torch.tensor(centre)).norm(dim=-1) - radius


def dice(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(2 * ((a < 0) & (b < 0)).sum() / ((a < 0).sum() + (b < 0).sum()))


def test_a_shape_meets_another_and_does_not_fold():
    moving, fixed = ball((11.0, 11.0, 9.0), 5.0), ball((13.5, 10.0, 10.0), 6.5)
    u = displacement(moving, fixed)
    assert dice(moving, fixed) < 0.7
    # It stays smooth, so it does not come all of the way.
    assert dice(warped(moving[None], u)[0], fixed) > 0.85
    assert volumes(u).amin() > 0.1


def test_a_shape_that_is_there_already_stays():
    moving = ball((11.0, 11.0, 9.0), 5.0)
    torch.testing.assert_close(displacement(moving, moving), torch.zeros(3, *SHAPE), atol=1e-5, rtol=0)


def test_volumes_of_a_stretched_volume():
    place = torch.stack(torch.meshgrid(*(torch.arange(float(n)) for n in SHAPE), indexing="ij"))
    u = torch.stack([0.5 * place[0], 0.1 * place[0] - 0.2 * place[1], 0 * place[2]])
    torch.testing.assert_close(volumes(u), torch.full(SHAPE, 1.5 * 0.8))


def test_points_move_where_their_voxels_do():
    u = displacement(ball((11.0, 11.0, 9.0), 5.0), ball((13.5, 10.0, 10.0), 6.5))
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 8 + 6
    there = moved(points, u)
    # x + u(x) = y: what an image of places shows there is the point's own place.
    place = torch.stack(torch.meshgrid(*(torch.arange(float(n)) for n in SHAPE), indexing="ij"))
    shown = warped(place, u)
    at = (there / (torch.tensor(SHAPE) - 1) * 2 - 1).flip(1).reshape(1, -1, 1, 1, 3)
    seen = torch.nn.functional.grid_sample(shown[None], at, align_corners=True).reshape(3, -1).T
    assert (there - points).norm(dim=1).max() > 1
    torch.testing.assert_close(seen, points, atol=0.02, rtol=0)


def test_a_displacement_of_larger_voxels_is_that_of_all():
    u = torch.full((3, 5, 4, 3), 1.5)
    fine = enlarged(u, 2, (9, 8, 5))
    assert fine.shape == (3, 9, 8, 5)
    assert torch.equal(fine, torch.full_like(fine, 3.0))
