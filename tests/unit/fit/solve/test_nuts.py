"""The sampler against the Laplace posterior, on an image that determines the shape well."""

from __future__ import annotations

import pytest
import torch

from sdm.fit import ExactBackend, FitOptions, Scanner, fit_shape, random_state, sample_posterior, simulate
from sdm.shapes import Cochlea


@pytest.mark.slow
def test_draws_have_the_laplace_width() -> None:
    pytest.importorskip("pyro", reason="sampling needs Pyro")
    backend = ExactBackend(Cochlea(1_000), "cpu")
    truth = random_state(backend, 8, edge=0.3)
    image = simulate(backend, truth, Scanner(spacing=0.6, blur=0.3, noise=200.0), seed=0)
    options = FitOptions(blur=0.3, starts=1, fine=0.3)
    result = fit_shape(image.values, image.grid, backend, options=options)
    drawn = sample_posterior(result, image.values, image.grid, backend, options=options, count=24, warm_up=8)
    assert drawn.increments.shape == (24, 10)
    ratio = drawn.increments.std(0) / result.posterior.deviations
    # A deviation from 24 draws is within about 15 % of itself.
    assert bool(((ratio > 0.4) & (ratio < 1.8)).all())
    assert float((drawn.increments.mean(0) / result.posterior.deviations).abs().max()) < 1.0
    assert drawn.divergences <= 2
    assert torch.isfinite(drawn.increments).all()
