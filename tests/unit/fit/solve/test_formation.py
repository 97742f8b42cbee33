"""The image's formation estimated with the shape: intervals hold under other blur, shading and correlated noise."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

import sdm
from sdm.errors import SDMError
from sdm.fit import ExactBackend, FitOptions, FitResult, Image, Scanner, State, fit_shape, random_state, simulate
from sdm.fit.solve.formation.estimate import estimate_formation
from sdm.fit.solve.formation.intensity_field import polynomials
from sdm.fit.solve.formation.noise_correlation import autocorrelation, correlated_information, effective_share
from sdm.fit.solve.formation.predictive_check import predictive_p
from sdm.shapes import StatisticalShape

OPTIONS = FitOptions(blur=0.45, fine=0.4)
NOISE = 60.0


@pytest.fixture(scope="module")
def scene() -> tuple[ExactBackend, State, Image]:
    small = StatisticalShape.example()
    size = torch.tensor([4.0, 3.2, 2.6])
    family = StatisticalShape(small.mean * size, small.modes, 4 * small.deviations, small.faces)
    backend = ExactBackend(family, "cpu")
    state = random_state(backend, seed=1, edge=0.2)
    grid = sdm.Grid((-6.2, -6.1, -6.3), (0.8,) * 3, (16, 16, 16))
    return backend, state, simulate(backend, state, Scanner(spacing=0.8, blur=0.6, noise=0.0), seed=1, grid=grid)


def noise(correlated: bool) -> torch.Tensor:
    values = np.random.default_rng(3).standard_normal((16, 16, 16))
    values = gaussian_filter(values, 0.6, mode="wrap") if correlated else values
    return torch.from_numpy(NOISE * values / values.std())


@pytest.fixture(scope="module")
def first(scene: tuple[ExactBackend, State, Image]) -> FitResult:
    backend, _, clean = scene
    return fit_shape(clean.values.double() + noise(correlated=False), clean.grid, backend, options=OPTIONS)


def test_blur_shading_and_correlation_together(scene: tuple[ExactBackend, State, Image], first: FitResult):
    backend, truth, clean = scene
    across = torch.linspace(-1, 1, 16, dtype=torch.float64)[:, None, None]
    values = clean.values.double() * (1 + 0.1 * across) + noise(correlated=True)
    found = estimate_formation(values, clean.grid, backend, first, OPTIONS)
    assert found.trusted, found.diagnosis.problems
    assert found.formation is not None
    blur, deviation = found.formation.blur
    assert abs(blur - 0.6) < 4 * deviation < 0.3
    assert found.formation.effective_share < 0.3
    assert found.posterior.standardised(truth).abs().max() < 3
    assert found.posterior.deviations[0] > 1.3 * first.posterior.deviations[0]
    # The outside's slope along x is a tenth of its intensity of 1700.
    outside = found.formation.coefficients.chunk(2)[1]
    assert float(outside[1:].abs().max()) == pytest.approx(170, abs=30)
    left = values - found.expected
    assert float(left.std()) < 1.2 * NOISE
    assert found.record()["formation"]["p_value"] == found.formation.p_value


def test_as_assumed_intervals_stay(scene: tuple[ExactBackend, State, Image], first: FitResult):
    backend, truth, clean = scene
    values = clean.values.double() + noise(correlated=False)
    found = estimate_formation(values, clean.grid, backend, first, OPTIONS)
    assert found.trusted
    assert found.formation is not None
    assert found.formation.p_value > 1e-3
    assert found.formation.effective_share > 0.8
    assert found.posterior.standardised(truth).abs().max() < 3.5
    # Shifts are confounded with intensities that tilt; the shape is not.
    assert float((found.posterior.deviations / first.posterior.deviations)[:3].max()) < 1.3


def test_what_the_model_does_not_describe_is_refused(scene: tuple[ExactBackend, State, Image], first: FitResult):
    backend, _, clean = scene
    # A rim that is brighter and darker by turns: neither the shape nor the formation makes one.
    share = ((clean.values.double() - 1700) / -1600).clamp(0, 1)
    turns = torch.sign(torch.sin(1.5 * torch.arange(16, dtype=torch.float64)))[:, None, None]
    values = clean.values.double() + 2000 * turns * share * (1 - share) + noise(correlated=False)
    found = estimate_formation(values, clean.grid, backend, first, OPTIONS)
    assert not found.trusted
    assert any("does not describe the image" in sentence for sentence in found.diagnosis.problems)


def test_other_models_are_refused(scene: tuple[ExactBackend, State, Image], first: FitResult):
    backend, _, clean = scene
    with pytest.raises(SDMError, match="partial-volume"):
        estimate_formation(clean.values, clean.grid, backend, first, FitOptions(model="labels"))
    with pytest.raises(SDMError, match="degree is 4"):
        estimate_formation(clean.values, clean.grid, backend, first, OPTIONS, degree=4)


def test_correlation_of_smoothed_noise():
    rng = np.random.default_rng(0)
    white = rng.standard_normal((24, 24, 24))
    assert effective_share(autocorrelation(torch.from_numpy(white))) == pytest.approx(1, abs=0.1)
    smooth = gaussian_filter(white, 0.6, mode="wrap")
    lags = autocorrelation(torch.from_numpy(smooth / smooth.std()))
    assert lags[1, 0, 0] == pytest.approx(0.5, abs=0.06)
    # The variance of a sum over a block, from many blocks.
    rows = torch.zeros(1, 24, 24, 24, dtype=torch.float64)
    rows[0, 4:8, 4:8, 4:8] = 1
    sums = [gaussian_filter(rng.standard_normal((10,) * 3), 0.6, mode="wrap")[3:7, 3:7, 3:7].sum() for _ in range(600)]
    expected = np.var(sums) / smooth.var()
    assert float(correlated_information(rows, lags)) == pytest.approx(expected, rel=0.2)


def test_p_values_are_even_and_find_misfit():
    near = torch.zeros(20, 20, 20, dtype=torch.bool)
    near[6:14, 6:14, 6:14] = True
    rng = np.random.default_rng(1)
    found = []
    for _ in range(60):
        residual = torch.from_numpy(rng.standard_normal((20, 20, 20)))
        found.append(predictive_p(residual, near, 0, {})[0])
    assert 0.02 <= np.mean(np.array(found) < 0.2) <= 0.4
    worse = torch.where(near, 1.5 * residual, residual)
    p, excess = predictive_p(worse, near, 0, {})
    assert p < 1e-6
    assert excess == pytest.approx(2.25, rel=0.2)


def test_polynomials():
    assert [polynomials((5, 4, 3), degree, torch.device("cpu")).shape for degree in (0, 1, 2)] == [
        (60, 1), (60, 4), (60, 10)
    ]  # fmt: skip
