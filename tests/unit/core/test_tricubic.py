"""Tricubic interpolation: exact for quadratics, smooth, and nearer to a smooth function than trilinear."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm

TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
GRID = sdm.Grid((-1.0, 2.0, 0.5), (0.5, 0.25, 1.0), (7, 8, 6), TURN)


def field_of(function) -> sdm.SDM:
    return sdm.SDM(function(GRID.points().double()).float(), GRID)


def points_within(margin: float, count: int = 200) -> torch.Tensor:
    """Random points, so many voxels or more from the border."""
    random = np.random.default_rng(0)
    index = random.uniform(margin, np.array(GRID.shape) - 1 - margin, (count, 3))
    return torch.from_numpy(index @ GRID.affine[:3, :3].T + GRID.affine[:3, 3])


def quadratic(at: torch.Tensor) -> torch.Tensor:
    x, y, z = at.unbind(-1)
    return 0.3 * x * x - x * y + 0.5 * z * z + y - 2


def linear(at: torch.Tensor) -> torch.Tensor:
    return at @ torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64) + 1


def test_quadratics_are_exact_inside():
    at = points_within(1)
    torch.testing.assert_close(field_of(quadratic).sample(at, order=3).double(), quadratic(at), atol=2e-6, rtol=0)
    assert float((field_of(quadratic).sample(at) - quadratic(at)).abs().max()) > 0.01


def test_linear_maps_are_exact_up_to_the_border():
    at = points_within(0)
    torch.testing.assert_close(field_of(linear).sample(at, order=3).double(), linear(at), atol=2e-6, rtol=0)


def test_voxel_centres_keep_their_values():
    field = sdm.SDM(torch.rand(GRID.shape, generator=torch.Generator().manual_seed(0)), GRID)
    torch.testing.assert_close(field.sample(GRID.points(), order=3), field.values, atol=1e-5, rtol=0)


def test_beyond_the_grid_is_nothing():
    far = torch.tensor([[100.0, 0, 0], [torch.nan, 0, 0]])
    assert field_of(linear).sample(far, order=3).isnan().all()


@pytest.mark.parametrize("shape", [(1, 5, 4), (2, 1, 2), (3, 2, 1)])
def test_thin_grids(shape):
    grid = sdm.Grid((0, 0, 0), (1, 1, 1), shape)
    field = sdm.SDM(grid.points()[..., 0] + 2 * grid.points()[..., 1] - grid.points()[..., 2], grid)
    at = torch.from_numpy(np.random.default_rng(1).uniform(0, 1, (50, 3)) * (np.array(shape) - 1))
    wanted = at @ torch.tensor([1.0, 2, -1], dtype=torch.float64)
    torch.testing.assert_close(field.sample(at, order=3).double(), wanted, atol=1e-6, rtol=0)


@pytest.mark.parametrize("order", [1, 3])
def test_derivatives(order):
    values = torch.rand((4, 3, 5), dtype=torch.float64, generator=torch.Generator().manual_seed(1)).requires_grad_()
    grid = sdm.Grid((0, 0, 0), (0.5, 1.0, 2.0), (4, 3, 5))
    at = torch.tensor([[0.3, 0.4, 1.1], [1.2, 1.7, 7.3], [0.7, 1.3, 3.1]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v, p: sdm.SDM(v, grid).sample(p, order), (values, at))


def test_the_slope_has_no_kinks():
    field = sdm.SDM(torch.rand(GRID.shape, generator=torch.Generator().manual_seed(2)), GRID)
    centre = torch.from_numpy(GRID.affine[:3, :3] @ [3.0, 4.0, 3.0] + GRID.affine[:3, 3])
    at = (centre + 1e-6 * torch.tensor([[1.0, 1, 1], [-1, -1, -1]])).requires_grad_()
    (slope,) = torch.autograd.grad(field.sample(at, order=3).sum(), at)
    torch.testing.assert_close(slope[0], slope[1], atol=1e-4, rtol=0)


def test_other_orders_are_refused():
    with pytest.raises(sdm.SDMError, match=r"order 1 \(trilinear\) or 3"):
        field_of(linear).sample([0, 0, 0], order=2)
