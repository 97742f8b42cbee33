"""Blur estimated with the shape: what a wrong blur spoils comes right, and intervals grow by what is not known."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.errors import SDMError
from sdm.fit import ExactBackend, FitOptions, Scanner, fit_shape, random_state, simulate
from sdm.fit.solve.estimate_blur import estimate_blur
from sdm.shapes import StatisticalShape


def test_a_wrong_blur_is_mended():
    small = StatisticalShape.example()
    size = torch.tensor([4.0, 3.2, 2.6])
    family = StatisticalShape(small.mean * size, small.modes, 4 * small.deviations, small.faces)
    backend = ExactBackend(family, "cpu")
    state = random_state(backend, seed=1, edge=0.2)
    grid = sdm.Grid((-6.2, -6.1, -6.3), (0.8,) * 3, (16, 16, 16))
    image = simulate(backend, state, Scanner(spacing=0.8, blur=0.6, noise=40), seed=1, grid=grid)
    options = FitOptions(blur=0.4, fine=0.4)
    first = fit_shape(image.values, grid, backend, options=options)
    steps = []
    found = estimate_blur(image.values, grid, backend, first, options, report=lambda *told: steps.append(told))
    assert steps == [("blur", number) for number in range(len(steps))]
    assert len(steps) > 2
    assert found.blur is not None
    blur, deviation = found.blur
    assert found.record()["blur"]["estimate"] == blur
    assert blur == pytest.approx(0.6, abs=max(0.03, 3 * deviation))
    assert 0 < deviation < 0.05
    assert found.trusted
    assert found.objective < first.objective
    off = [float((r.state.theta - state.theta).norm()) for r in (first, found)]
    assert off[1] < 0.1
    with pytest.raises(SDMError, match="partial-volume"):
        estimate_blur(image.values, grid, backend, first, FitOptions(model="labels"))
