"""A fit finds the shape and pose that an image was made of, whichever backend it has."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from sdm import Grid, SDMError
from sdm.errors import GridError
from sdm.fit import ExactBackend, FitOptions, FitResult, Image, Scanner, State, fit_shape, random_state, simulate
from sdm.fit.model.spline_backend import GridBackend
from sdm.shapes import Cochlea

SCANNER = Scanner(spacing=0.5, blur=0.25, noise=200.0)
OPTIONS = FitOptions(blur=SCANNER.blur, starts=2, fine=0.25)
TRIANGLES = 2_000


@pytest.fixture(scope="module")
def backend() -> ExactBackend:
    return ExactBackend(Cochlea(TRIANGLES), "cpu")


@pytest.fixture(scope="module")
def truth(backend: ExactBackend) -> State:
    return random_state(backend, 5, edge=0.25)


@pytest.fixture(scope="module")
def image(backend: ExactBackend, truth: State) -> Image:
    return simulate(backend, truth, SCANNER, seed=1)


@pytest.fixture(scope="module")
def result(backend: ExactBackend, image: Image) -> FitResult:
    return fit_shape(image.values, image.grid, backend, options=OPTIONS)


def test_the_truth_is_within_the_posterior(result: FitResult, truth: State) -> None:
    assert result.require() is result
    z = result.posterior.standardised(truth)
    # Chi-squared with 10 degrees of freedom exceeds 30 once in 1,000 such images; this one is fixed.
    assert float(z.abs().max()) < 3.5
    assert float((z**2).sum()) < 30
    assert float(result.posterior.deviations[0]) < 0.05


def test_appearance_is_found(result: FitResult) -> None:
    assert abs(result.appearance.inside.mean - SCANNER.inside) < 50
    assert abs(result.appearance.outside.mean - SCANNER.outside) < 10
    assert abs(result.appearance.outside.deviation - SCANNER.noise) < 10


def test_intervals_and_record(result: FitResult, tmp_path: Path) -> None:
    ends = result.posterior.intervals(0.9)
    assert torch.allclose((ends[:, 1] - ends[:, 0]) / 2, 1.6448536 * result.posterior.deviations)
    result.save(tmp_path / "fit.json")
    page = result._repr_html_()
    assert all(parameter.name in page for parameter in result.parameters)
    record = json.loads((tmp_path / "fit.json").read_text())
    assert record["trusted"]
    assert record["theta"]["a"]["interval"] == pytest.approx(ends[0].tolist())


def test_hybrid_and_anchored_end_where_exact_does(backend: ExactBackend, image: Image, result: FitResult) -> None:
    """A surrogate that is off by hundredths of a millimetre, and right to first order alone."""
    grid = Grid((-6.5, -6.0, -2.8), (0.4, 0.4, 0.4), (40, 32, 20))
    points = grid.points().double().reshape(-1, 3)
    middle = result.state.theta + torch.tensor([0.05, -0.03, 0.002, 0.05])
    found = backend.with_derivatives(middle, points)

    def model(theta: Tensor) -> Tensor:
        values = found.values + (theta[0].double() - middle) @ found.by_theta.T + 0.01
        return values.float().reshape(1, 1, *grid.shape)

    surrogate = GridBackend(model, grid)
    # Each backend turns shapes about a centre of its own; a pose means the same only with the same one.
    surrogate.centre = backend.centre
    # One start, as where they end is what matters.
    options = replace(OPTIONS, starts=1)
    hybrid = fit_shape(image.values, image.grid, surrogate, finish=backend, options=options)
    alone = fit_shape(image.values, image.grid, surrogate, options=options)
    surrogate.exact = backend
    anchored = fit_shape(image.values, image.grid, surrogate, options=options)
    errors = [
        float(((found.state.theta - result.state.theta) / result.state.theta).abs().max())
        for found in (hybrid, anchored, alone)
    ]
    assert errors[0] < 1e-4
    assert errors[1] < 1e-2
    assert errors[2] > 2e-2
    assert hybrid.evaluations["exact"] < result.evaluations["exact"] / 2
    assert anchored.evaluations["exact"] == 2
    assert list(anchored.steps) == ["start", "fine", "anchored", "finish"]
    assert "exact" not in alone.evaluations


def test_labels_find_it_too(backend: ExactBackend, image: Image, truth: State) -> None:
    options = FitOptions(model="labels", starts=1)
    found = fit_shape(image.values, image.grid, backend, options=options)
    assert found.diagnosis.converged
    assert float((found.state.theta - truth.theta).abs()[:1]) < 0.1


def test_bad_input(backend: ExactBackend, image: Image) -> None:
    with pytest.raises(GridError, match="does not fit a grid"):
        fit_shape(image.values[1:], image.grid, backend)
    with pytest.raises(SDMError, match="not finite"):
        fit_shape(image.values / 0 * 0, image.grid, backend)
    with pytest.raises(SDMError, match="one value everywhere"):
        fit_shape(0 * image.values, image.grid, backend)
    with pytest.raises(SDMError, match="no model called"):
        fit_shape(image.values, image.grid, backend, options=FitOptions(model="guess"))
    with pytest.raises(GridError, match="too small"):
        fit_shape(torch.zeros(4, 30, 30), Grid((0, 0, 0), (0.3, 0.3, 0.3), (4, 30, 30)), backend)
