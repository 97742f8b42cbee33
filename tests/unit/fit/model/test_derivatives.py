"""Derivatives of exact signed distances by shape and pose, against central differences in float64."""

from __future__ import annotations

import pytest
import torch

from sdm import Grid
from sdm.fit.model.exact import ExactBackend
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State, rotation_from_vector
from sdm.shapes import Cochlea

THETA = torch.tensor([3.6, 0.5, 0.14, -0.2], dtype=torch.float64)


@pytest.fixture(scope="module")
def backend() -> ExactBackend:
    return ExactBackend(Cochlea(3_000), "cpu")


def _state(backend: ExactBackend) -> State:
    turn = rotation_from_vector(torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64))
    return State(THETA, turn, torch.tensor([0.1, 0.2, -0.3], dtype=torch.float64), backend.centre)


@pytest.mark.parametrize("column", range(10))
def test_distances_by_every_increment(backend: ExactBackend, column: int) -> None:
    state = _state(backend)
    points = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    points = (points - 0.5) * torch.tensor([10.0, 8.0, 5.0])
    at = state.to_shape(points)
    found = backend.with_derivatives(state.theta, at)
    analytic = state.chain(at, found.by_theta, found.by_point)[:, column]
    step = torch.zeros(10, dtype=torch.float64)
    step[column] = 1e-4
    ahead, behind = (
        backend.with_derivatives(moved.theta, moved.to_shape(points)).values
        for moved in (state.moved(step), state.moved(-step))
    )
    difference = (ahead - behind) / 2e-4
    error = (analytic - difference).abs()
    # At kinks of the distance (the medial axis, and the facets' own) the two-sided difference means nothing.
    assert float((error < 1e-3 * (1 + difference.abs())).double().mean()) > 0.97
    assert float(error.median()) < 1e-5
    assert float(analytic.abs().max()) > 0.3


def test_distances_are_the_engines(backend: ExactBackend) -> None:
    points = torch.rand(2_000, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64) * 6 - 3
    precise = backend.with_derivatives(THETA, points)
    plain = backend.distances(THETA, points)
    assert float((precise.values - plain).abs().max()) < 2e-6
    assert torch.equal(precise.values < 0, plain < 0)
    assert torch.allclose(precise.by_point.norm(dim=1), torch.ones((), dtype=torch.float64))


def test_rendered_share_by_every_increment(backend: ExactBackend) -> None:
    grid = Grid((-6.0, -5.0, -3.0), (0.5, 0.5, 0.5), (25, 21, 14))
    renderer = Renderer(grid, backend, blur=0.25, length=0.05, fine=0.17)
    state = _state(backend)
    by_step = renderer(state).by_step
    assert by_step is not None
    for column in range(10):
        step = torch.zeros(10, dtype=torch.float64)
        step[column] = 2e-4
        difference = renderer(state.moved(step)).share - renderer(state.moved(-step)).share
        difference = difference / 4e-4
        error = (by_step[column] - difference).abs().max()
        assert float(error) < 2e-2 * float(difference.abs().max()), column
