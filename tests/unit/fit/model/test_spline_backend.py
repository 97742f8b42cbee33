"""Distances from maps on a grid: a model whose maps are known in closed form."""

from __future__ import annotations

import torch

from sdm import Grid
from sdm.fit.model.backend import rough_of
from sdm.fit.model.backends import make_backends
from sdm.fit.model.spline_backend import GridBackend
from sdm.shapes import Parameter

GRID = Grid((-3.0, -3.0, -3.0), (0.2, 0.2, 0.25), (31, 31, 25))
PARAMETERS = (Parameter("r", 0.5, 2.0, "mm"), Parameter("x", -0.5, 0.5, "mm"))


def ball(theta: torch.Tensor) -> torch.Tensor:
    """Distances to balls of radius theta[:, 0] about (theta[:, 1], 0, 0)."""
    points = GRID.points()
    centre = torch.stack([theta[:, 1], 0 * theta[:, 1], 0 * theta[:, 1]], 1)
    return ((points - centre[:, None, None, None]).norm(dim=-1) - theta[:, 0, None, None, None])[:, None]


def _backend() -> GridBackend:
    return GridBackend(ball, GRID, PARAMETERS)


def test_values_and_derivatives_between_voxels() -> None:
    backend, theta = _backend(), torch.tensor([1.3, 0.2], dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    direction = torch.nn.functional.normalize(torch.randn(4_000, 3, generator=generator, dtype=torch.float64), dim=1)
    # The map has a kink at the ball's centre; splines feel it less with every voxel.
    radius = 1.3 + 0.1 * (2 * torch.rand(4_000, 1, generator=generator, dtype=torch.float64) - 1)
    points = direction * radius + torch.tensor([0.2, 0.0, 0.0])
    found = backend.with_derivatives(theta, points)
    assert float((found.values - (radius[:, 0] - 1.3)).abs().max()) < 3e-4
    assert float((found.by_point - direction).abs().max()) < 2e-3
    assert float((found.by_theta[:, 0] + 1).abs().max()) < 1e-5
    assert float((found.by_theta[:, 1] + direction[:, 0]).abs().max()) < 2e-3
    assert torch.equal(backend.distances(theta, points), found.values)


def test_linear_functions_are_exact_up_to_the_grids_end() -> None:
    def plane(theta: torch.Tensor) -> torch.Tensor:
        return (GRID.points() @ torch.tensor([0.6, 0.0, 0.8]))[None, None] - theta[:, :1, None, None, None]

    backend = GridBackend(plane, GRID, PARAMETERS)
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 6 - 3
    found = backend.with_derivatives(torch.tensor([0.5, 0.0]), points)
    assert float((found.values - (points @ torch.tensor([0.6, 0.0, 0.8]).double() - 0.5)).abs().max()) < 1e-5


def test_beyond_the_grid_distances_go_on_growing() -> None:
    backend, theta = _backend(), torch.tensor([1.0, 0.0])
    far = torch.tensor([[7.0, 0.0, 0.0]], dtype=torch.float64)
    assert abs(float(backend.distances(theta, far)) - 6.0) < 1e-3


def test_a_theta_is_evaluated_once() -> None:
    backend, theta, point = _backend(), torch.tensor([1.0, 0.0]), torch.zeros(1, 3, dtype=torch.float64)
    backend.distances(theta, point)
    backend.with_derivatives(theta, point)
    backend.distances(theta, point + 1)
    assert backend.evaluations == 1


def test_the_shipped_surrogate_has_a_rough_one() -> None:
    backend = make_backends("surrogate", device="cpu")[0]
    rough = rough_of(backend)
    assert rough is not backend
    assert torch.equal(rough.centre, backend.centre)
    theta = torch.tensor([3.7, 0.45, 0.146, 0.6], dtype=torch.float64)
    points = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    points = points * torch.tensor([10.0, 8.0, 4.0]) - torch.tensor([4.0, 4.0, 1.0])
    fine, coarse = backend.with_derivatives(theta, points), rough.with_derivatives(theta, points)
    near = fine.values.abs() < 0.5
    assert float((fine.values - coarse.values)[near].abs().mean()) < 0.15
    for number in range(4):
        a, b = fine.by_theta[near][:, number], coarse.by_theta[near][:, number]
        assert float((a * b).sum() / (a.norm() * b.norm())) > 0.97
