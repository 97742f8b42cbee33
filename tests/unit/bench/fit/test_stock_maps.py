"""Whole stock maps are near our distances and derivatives, so that the benchmark compares the same fit."""

from __future__ import annotations

import pytest
import torch

from sdm import Grid
from sdm.bench.fit.closest_maps import ClosestMaps
from sdm.bench.fit.stock_maps import StockMaps
from sdm.fit import ExactBackend
from sdm.fit.model.backend import exact_of
from sdm.shapes import Cochlea
from sdm.surrogate import GRID

# Half the resolution of the studies, for the test's time.
COARSE = Grid(GRID.origin, [2 * s for s in GRID.spacing], [n // 2 for n in GRID.shape])


def test_maps_and_finite_differences_are_near_the_exact_ones() -> None:
    exact = ExactBackend(Cochlea(2_000), "cpu")
    maps = StockMaps("warp", 2_000, COARSE)
    theta = torch.tensor([3.6, 0.5, 0.14, -0.2], dtype=torch.float64)
    points = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    points = (points - 0.5) * torch.tensor([8.0, 6.0, 3.0])
    first = maps.distances(theta, points)
    ours, theirs = exact.with_derivatives(theta, points), maps.with_derivatives(theta, points)
    assert torch.equal(first, theirs.values)
    assert float((ours.values - theirs.values).abs().median()) < 0.02
    assert float((ours.by_theta - theirs.by_theta).abs().median()) < 0.05
    assert float((ours.by_point - theirs.by_point).abs().median()) < 0.1
    assert maps.evaluations == 1 + len(exact.parameters)
    assert maps.centre.equal(exact.centre)


@pytest.mark.parametrize("library", ["exact", "libigl"])
def test_maps_by_closest_points_are_near_the_exact_distances(library: str) -> None:
    if library == "libigl":
        pytest.importorskip("igl", reason="libigl is not installed")
    exact, maps = ExactBackend(Cochlea(2_000), "cpu"), ClosestMaps(library, 2_000, COARSE)
    theta = torch.tensor([3.6, 0.5, 0.14, -0.2], dtype=torch.float64)
    points = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    points = (points - 0.5) * torch.tensor([8.0, 6.0, 3.0])
    first = maps.distances(theta, points)
    ours, theirs = exact.with_derivatives(theta, points), maps.with_derivatives(theta, points)
    assert float((first - theirs.values).abs().max()) < 1e-5
    assert float((ours.values - theirs.values).abs().median()) < 0.02
    assert float((ours.by_theta - theirs.by_theta).abs().median()) < 0.05
    # Of the voxels themselves, to the rounding of either way.
    whole = maps.maps(theta, derivatives=True)
    at = exact.with_derivatives(theta, COARSE.points().reshape(-1, 3).double())
    assert float((whole[0].reshape(-1) - at.values).abs().max()) < 1e-5
    assert float(((whole[1:].reshape(4, -1).T - at.by_theta).abs().amax(1) < 1e-3).double().mean()) > 0.98
    assert exact_of(maps) is maps.exact is not None
    assert maps.evaluations == 1
