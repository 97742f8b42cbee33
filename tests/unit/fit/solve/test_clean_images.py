"""Images with little noise are fitted, and misfit is told rather than refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sdm.fit import ExactBackend, FitOptions, Scanner, fit_shape, random_state, simulate
from sdm.fit.solve.diagnosis import diagnose
from sdm.fit.solve.fit_shape import prior_of
from sdm.fit.solve.solver import Outcome
from sdm.shapes import Cochlea

OPTIONS = FitOptions(starts=1, fine=0.25)


@pytest.fixture(scope="module")
def backend() -> ExactBackend:
    return ExactBackend(Cochlea(2_000), "cpu")


@pytest.mark.parametrize(("noise", "blur", "tolerance"), [(0.0, 0.2, 0.01), (20.0, 0.3, 0.1)])
def test_good_images_have_an_answer(backend: ExactBackend, noise: float, blur: float, tolerance: float):
    truth = random_state(backend, 0, edge=0.1)
    finer = ExactBackend(Cochlea(8_000), "cpu")
    image = simulate(finer, truth, Scanner(spacing=0.5, blur=blur, noise=noise), seed=0)
    found = fit_shape(image.values, image.grid, backend, options=OPTIONS)
    assert found.diagnosis.converged, found.diagnosis
    assert found.trusted, found.diagnosis.problems
    assert float((found.state.theta - truth.theta).abs().max()) < tolerance
    # Another blur than the one that was named.
    assert any("--blur" in sentence for sentence in found.diagnosis.warnings)


def test_as_assumed_there_is_no_warning(backend: ExactBackend):
    truth = random_state(backend, 5, edge=0.25)
    image = simulate(backend, truth, Scanner(spacing=0.5, blur=0.2, noise=100.0), seed=1)
    found = fit_shape(image.values, image.grid, backend, options=OPTIONS)
    assert found.trusted
    assert not found.diagnosis.warnings
    assert found.diagnosis.misfit < 0.3


def test_a_search_that_stops_nearby_is_trusted(backend: ExactBackend):
    from sdm.fit.model.appearance import PartialVolume
    from sdm.fit.solve.fit_shape import renderer_of
    from sdm.fit.solve.solver import evaluate

    truth = random_state(backend, 5, edge=0.25)
    image = simulate(backend, truth, Scanner(spacing=0.5, blur=0.2, noise=100.0), seed=1)
    values, prior = image.values.double(), prior_of(image.grid, backend, OPTIONS)
    renderer = renderer_of(image.grid, backend, OPTIONS)
    share = renderer(truth, derivatives=False).share
    start = PartialVolume.start(values.flatten(), share.flatten())
    near = Outcome(evaluate(renderer, values, truth, start, prior), False, 0.4, 40, ())
    names = [p.name for p in backend.parameters]
    told = diagnose(values, image.grid, near, prior, names)
    assert told.trusted
    assert any("0.40 posterior standard deviations" in sentence for sentence in told.warnings)
    far = diagnose(values, image.grid, replace(near, left=3.0), prior, names)
    assert not far.trusted
    assert "--blur" in far.problems[0]
