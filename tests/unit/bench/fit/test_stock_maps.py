"""Whole stock maps are near our distances and derivatives, so that the benchmark compares the same fit."""

from __future__ import annotations

import torch

from sdm import Grid
from sdm.bench.fit.stock_maps import StockMaps
from sdm.fit import ExactBackend
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
