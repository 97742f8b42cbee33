"""The share of a voxel inside a ball, against the integral over the voxel and the point spread function."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from sdm import Grid
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.model.spline_backend import GridBackend
from sdm.shapes import Parameter

MAPS = Grid((-2.5, -2.5, -2.5), (0.1, 0.1, 0.1), (51, 51, 51))
RADIUS = 1.3


def ball(theta: torch.Tensor) -> torch.Tensor:
    return (MAPS.points().norm(dim=-1) - theta[0, 0])[None, None]


@pytest.fixture(scope="module")
def state() -> State:
    return State(
        torch.tensor([RADIUS], dtype=torch.float64),
        torch.eye(3, dtype=torch.float64),
        torch.tensor([0.07, -0.04, 0.11], dtype=torch.float64),
        torch.zeros(3, dtype=torch.float64),
    )


@pytest.mark.parametrize("blur", [0.0, 0.2])
def test_share_is_the_blurred_volume(state: State, blur: float) -> None:
    grid = Grid((-2.1, -2.1, -2.4), (0.3, 0.3, 0.4), (15, 15, 13))
    backend = GridBackend(ball, MAPS, (Parameter("r", 0.5, 2.0, "mm"),), slack=0.01)
    backend.centre = state.centre
    share = Renderer(grid, backend, blur=blur, length=0.02, fine=0.1)(state, derivatives=False).share
    # By brute force: 10 x 10 x 10 points a voxel, and SciPy's filter on them.
    parts = np.array([10, 10, 10])
    steps = np.array(grid.spacing) / parts
    axes = [
        o - s / 2 + (np.arange(n * p) + 0.5) * s / p
        for o, s, n, p in zip(grid.origin, grid.spacing, grid.shape, parts, strict=True)
    ]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    away = np.sqrt((x - 0.07) ** 2 + (y + 0.04) ** 2 + (z - 0.11) ** 2)
    inside = (away < RADIUS).astype(np.float64)
    if blur:
        inside = gaussian_filter(inside, blur / steps, truncate=6)
    blocks = inside.reshape([m for n, p in zip(grid.shape, parts, strict=True) for m in (n, p)]).mean((1, 3, 5))
    assert float(np.abs(share.numpy() - blocks).max()) < 0.03
    volume = 4 / 3 * np.pi * RADIUS**3
    assert float(share.sum()) * np.prod(grid.spacing) == pytest.approx(volume, rel=3e-3)


def test_one_point_a_voxel_and_no_blur_is_the_logistic(state: State) -> None:
    grid = Grid((-2.1, -2.1, -2.1), (0.3, 0.3, 0.3), (15, 15, 15))
    backend = GridBackend(ball, MAPS, (Parameter("r", 0.5, 2.0, "mm"),), slack=0.01)
    backend.centre = state.centre
    share = Renderer(grid, backend, blur=0.0, length=0.08, fine=0.3)(state, derivatives=False).share
    distance = (grid.points().double() - state.translation).norm(dim=-1) - RADIUS
    wanted = torch.sigmoid(-distance / 0.08)
    # Far from the surface the logistic is taken for 0 or 1.
    assert float((share - wanted).abs().max()) < 1e-3
