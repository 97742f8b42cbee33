"""The posterior by the No-U-Turn sampler (Hoffman and Gelman 2014), where a Gaussian about the estimate is not enough.

The sampler is Pyro's (the extra `nuts`). It walks in units of the Laplace posterior, so that all ten
unknowns have about the same width, with the appearance held at its estimate.
"""

from __future__ import annotations

import importlib
import warnings
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.grid import Grid
from sdm.core.random import derive_seed
from sdm.errors import SDMError
from sdm.fit.model.backend import Backend
from sdm.fit.model.prior import Prior
from sdm.fit.solve.fit_shape import FitOptions, image_tensor, prior_of, renderer_of
from sdm.fit.solve.result import FitResult
from sdm.fit.solve.solver import evaluate


@dataclass(frozen=True, eq=False)
class Samples:
    """Draws of a posterior.

    Args:
        increments: (N,P+6) float64 increments of `State.moved` at the estimate.
        accepted: Mean probability of acceptance; the sampler's target is 0.8.
        divergences: Trajectories that left the typical set: more than a few mean that it is not to be trusted.
    """

    increments: Tensor
    accepted: float
    divergences: int


def sample_posterior(
    result: FitResult,
    image: Any,
    grid: GridLike,
    backend: Backend,
    *,
    options: FitOptions | None = None,
    count: int = 200,
    warm_up: int = 50,
    seed: int = 0,
) -> Samples:
    """Draw from the posterior, beginning at the estimate of `fit_shape`.

    Args:
        result: What `fit_shape` returned for the same image and options.
        image: (nx,ny,nz) intensities.
        grid: Where its voxels are, as for `fit_shape`.
        backend: Where distances come from; each draw takes several evaluations. A surrogate is not anchored here.
        options: As given to `fit_shape`.
        count: Draws to keep.
        warm_up: Draws before those, for the step size.
        seed: Of the draws.

    Raises:
        SDMError: Pyro is not installed.
    """
    try:
        infer = importlib.import_module("pyro.infer")
    except ImportError as error:
        raise SDMError('sampling needs Pyro: pip install ".[nuts]" in a clone') from error
    options = FitOptions() if options is None else options
    grid = as_grid(grid)
    energy = _Energy(result, image_tensor(image, grid, backend.device), grid, backend, options)

    def potential(unknowns: dict[str, Tensor]) -> Tensor:
        return _Potential.apply(unknowns["z"], energy)  # type: ignore[return-value]

    size = len(result.posterior.covariance)
    with warnings.catch_warnings(), torch.random.fork_rng():
        # Pyro's own use of torch.
        warnings.simplefilter("ignore")
        torch.manual_seed(derive_seed(seed, "draws of a posterior"))
        kernel = infer.NUTS(potential_fn=potential, step_size=0.5, adapt_mass_matrix=False, max_tree_depth=4)
        start = {"z": torch.zeros(size, dtype=torch.float64, device=backend.device)}
        chain = infer.MCMC(kernel, count, warmup_steps=warm_up, initial_params=start, disable_progbar=True)
        chain.run()
        drawn = chain.get_samples()["z"]
        said = chain.diagnostics()
    accepted = said.get("acceptance rate", {}).get("chain 0", float("nan"))
    divergences = len(said.get("divergences", {}).get("chain 0", []))
    return Samples(drawn @ energy.scale.T, float(accepted), divergences)


class _Energy:
    """Minus the log posterior of whitened increments z, and its gradient."""

    def __init__(self, result: FitResult, image: Tensor, grid: Grid, backend: Backend, options: FitOptions) -> None:
        self.result, self.image = result, image
        self.prior: Prior = prior_of(grid, backend, options)
        self.renderer = renderer_of(grid, backend, options)
        self.scale = torch.linalg.cholesky(result.posterior.covariance)

    def __call__(self, z: Tensor) -> tuple[float, Tensor]:
        step = self.scale @ z
        count = len(self.prior.low)
        # Beyond the ranges a steep wall, so that trajectories turn back.
        theta = self.result.state.theta + step[:count]
        beyond = theta - theta.clamp(self.prior.low, self.prior.high)
        wall = (1e3 / (self.prior.high - self.prior.low)) ** 2
        step = torch.cat([step[:count] - beyond, step[count:]])
        state = self.result.state.moved(step)
        at = evaluate(self.renderer, self.image, state, self.result.appearance, self.prior, em_steps=0)
        gradient = at.gradient.clone()
        gradient[:count] += wall * beyond
        return at.objective + 0.5 * float((wall * beyond**2).sum()), self.scale.T @ gradient


class _Potential(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, z: Tensor, energy: _Energy) -> Tensor:
        value, gradient = energy(z.detach())
        ctx.save_for_backward(gradient)
        return z.new_tensor(value)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return upstream[0] * gradient, None
