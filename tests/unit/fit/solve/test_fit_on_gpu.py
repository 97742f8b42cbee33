"""A fit on a GPU, its formation estimated too: it ends where a CPU's does."""

from __future__ import annotations

import pytest
import torch

from sdm.fit import ExactBackend, FitOptions, FitResult, Scanner, fit_shape, random_state, simulate
from sdm.fit.solve.formation.estimate import estimate_formation
from sdm.shapes import Cochlea

pytestmark = pytest.mark.gpu

SCANNER = Scanner(spacing=0.5, blur=0.25, noise=200.0)
OPTIONS = FitOptions(blur=SCANNER.blur, starts=2, fine=0.25)


def test_ends_where_a_cpu_does() -> None:
    backends = [ExactBackend(Cochlea(2_000), device) for device in ("cpu", "cuda")]
    image = simulate(backends[0], random_state(backends[0], 5, edge=0.25), SCANNER, seed=1)
    plain = [fit_shape(image.values, image.grid, backend, options=OPTIONS).require() for backend in backends]
    _same(*plain)
    _same(*[estimate_formation(image.values, image.grid, b, r, OPTIONS) for b, r in zip(backends, plain, strict=True)])


def _same(cpu: FitResult, cuda: FitResult) -> None:
    apart = cuda.posterior.state.theta.cpu() - cpu.posterior.state.theta
    assert (apart.abs() / cpu.posterior.deviations[: len(apart)]).max() < 0.1
    assert torch.allclose(cuda.posterior.deviations.cpu(), cpu.posterior.deviations, rtol=0.05)
