"""The stock libraries' finite differences are near our derivatives, so that the benchmark compares the same fit."""

from __future__ import annotations

import pytest
import torch

from sdm.bench.fit.stock_backend import StockBackend
from sdm.bench.fit.stock_closest import ClosestPointBackend, filled_up
from sdm.bench.peers.libigl import THREADS_FROM
from sdm.fit import ExactBackend
from sdm.shapes import Cochlea


@pytest.mark.parametrize("name", ["libigl", "warp"])
def test_finite_differences_are_near_the_derivatives(name: str) -> None:
    if name == "libigl":
        pytest.importorskip("igl", reason="libigl is not installed")
    stock, exact = StockBackend(name, 2_000), ExactBackend(Cochlea(2_000), "cpu")
    theta = torch.tensor([3.6, 0.5, 0.14, -0.2], dtype=torch.float64)
    points = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    points = (points - 0.5) * torch.tensor([8.0, 6.0, 3.0])
    ours, theirs = exact.with_derivatives(theta, points), stock.with_derivatives(theta, points)
    assert float((ours.values - theirs.values).abs().max()) < 1e-4
    # Rounding of float32 over a step of a thousandth, and kinks.
    assert float((ours.by_theta - theirs.by_theta).abs().median()) < 5e-3
    assert float((ours.by_point - theirs.by_point).abs().median()) < 5e-3
    assert stock.evaluations == 5
    assert exact.evaluations == 1


def test_closest_points_of_libigl_give_our_derivatives() -> None:
    pytest.importorskip("igl", reason="libigl is not installed")
    stock, exact = ClosestPointBackend(Cochlea(2_000), "cpu"), ExactBackend(Cochlea(2_000), "cpu")
    theta = torch.tensor([3.6, 0.5, 0.14, -0.2], dtype=torch.float64)
    points = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    points = (points - 0.5) * torch.tensor([8.0, 6.0, 3.0])
    ours, theirs = exact.with_derivatives(theta, points), stock.with_derivatives(theta, points)
    assert float((ours.values - theirs.values).abs().max()) < 1e-5
    # But for points as far from one place as from another.
    assert float(((ours.by_theta - theirs.by_theta).abs().amax(1) < 1e-4).double().mean()) > 0.98
    assert (stock.evaluations, stock.rough()) == (1, None)
    assert isinstance(ClosestPointBackend(Cochlea(20_000), "cpu").rough(), ClosestPointBackend)


def test_few_points_are_filled_up_where_that_is_quicker() -> None:
    points = torch.arange(3 * 2_000, dtype=torch.float32).reshape(-1, 3)
    full = filled_up(points, threads=16)
    assert len(full) == THREADS_FROM
    assert torch.equal(full[:2_000], points)
    assert torch.equal(full[2_000:4_000], points)
    assert len(filled_up(points[:600], threads=16)) == 600
    assert len(filled_up(points, threads=2)) == 2_000
    assert len(filled_up(full.repeat(2, 1), threads=16)) == 2 * THREADS_FROM
