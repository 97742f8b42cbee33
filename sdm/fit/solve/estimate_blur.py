"""Blur of the scanner, estimated with the shape: intervals then hold what is not known of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.errors import SDMError
from sdm.fit.model.appearance import Appearance
from sdm.fit.model.backend import Backend
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.model.prior import Prior
from sdm.fit.solve.diagnosis import diagnose
from sdm.fit.solve.fit_shape import FitOptions, image_tensor, prior_of, renderer_of
from sdm.fit.solve.posterior import Posterior
from sdm.fit.solve.result import FitResult
from sdm.fit.solve.solver import Outcome, minimise

# Turns of blur and shape, and the relative change of the blur that ends them.
TURNS, STILL = 8, 2e-3
# Factors of the blur that a turn looks between, its evaluations, and the share of the blur for its derivative.
WIDE, LOOKS, STEP = 1.8, 9, 0.02
MOST_STEPS, EM_STEPS = 8, 4


def estimate_blur(
    image: Any,
    grid: GridLike,
    backend: Backend,
    result: FitResult,
    options: FitOptions,
    *,
    report: Callable[[str, int], None] | None = None,
) -> FitResult:
    """Go on from a fit with the blur as one unknown more.

    Args:
        image: As `fit_shape` had it.
        grid: As `fit_shape` had it.
        backend: Exact distances.
        result: Its result, by the blur of `options`.
        options: Its options; "partial-volume" alone has a blur.
        report: Called with "blur" and the number of each step, first of all with 0.

    Returns:
        The result with shape, pose and `blur` at their joint optimum, its covariance with the blur integrated out.

    Raises:
        SDMError: Another model, or a blur of 0 to begin with.
    """
    if options.model != "partial-volume" or not options.blur > 0:
        raise SDMError("a blur is estimated for the model partial-volume, from a blur above 0")
    grid = as_grid(grid)
    values = image_tensor(image, grid, backend.device)
    prior = prior_of(grid, backend, options)
    state, appearance, blur = result.state, result.appearance, options.blur
    outcome: Outcome | None = None
    told, numbers = report or (lambda *_: None), itertools.count()
    told("blur", next(numbers))
    for _ in range(TURNS):
        before = blur
        blur = _best_blur(values, prior, state, appearance, blur, lambda b: _renderer(grid, backend, options, b))
        renderer = _renderer(grid, backend, options, blur)
        outcome = minimise(
            renderer,
            values,
            state,
            appearance,
            prior,
            most_steps=MOST_STEPS,
            tolerance=options.tolerance,
            report=lambda *_: told("blur", next(numbers)),
        )
        state, appearance = outcome.point.state, outcome.point.appearance
        if abs(blur / before - 1) < STILL:
            break
    assert outcome is not None  # noqa: S101 - there is always a turn
    covariance = _with_blur(values, outcome, blur, lambda b: _renderer(grid, backend, options, b))
    count = len(outcome.point.gradient)
    names = [p.name for p in backend.parameters]
    return replace(
        result,
        posterior=Posterior(state, covariance[:count, :count]),
        appearance=appearance,
        share=outcome.point.share,
        objective=outcome.point.objective,
        diagnosis=diagnose(values, grid, outcome, prior, names),
        blur=(blur, float(covariance[count, count].clamp_min(0).sqrt())),
    )


def _renderer(grid: Any, backend: Backend, options: FitOptions, blur: float) -> Renderer:
    return renderer_of(grid, backend, replace(options, blur=blur))


def _best_blur(values: Tensor, prior: Prior, state: State, appearance: Appearance, blur: float, make: Any) -> float:
    """The blur at which the image is most probable, the shape held."""
    from scipy.optimize import minimize_scalar

    voxels = values.flatten()

    def objective(log_blur: float) -> float:
        share = make(math.exp(log_blur))(state, derivatives=False).share.flatten()
        own = appearance
        for _ in range(EM_STEPS):
            own = own.update(voxels, share)
        return -own.evidence(voxels, share).log_likelihood

    middle, reach = math.log(blur), math.log(WIDE)
    found: Any = minimize_scalar(
        objective, bounds=(middle - reach, middle + reach), method="bounded", options={"maxiter": LOOKS, "xatol": 1e-3}
    )
    return math.exp(float(found.x))


def _with_blur(values: Tensor, outcome: Outcome, blur: float, make: Any) -> Tensor:
    """Covariance (P+7,P+7) of shape, pose and blur, with the mean intensities integrated out."""
    at = outcome.point
    rendered = make(blur)(at.state)
    more, less = (make(blur * factor)(at.state, derivatives=False).share for factor in (1 + STEP, 1 - STEP))
    by_blur = ((more - less) / (2 * STEP * blur)).flatten()
    rows = at.appearance.evidence(values.flatten(), rendered.share.flatten()).rows
    own = by_blur * rows[:, 0]
    assert rendered.by_step is not None  # noqa: S101 - for the type checker
    shape = rendered.by_step.flatten(1).double() * rows[:, 0]
    count, size = len(at.gradient), len(at.full)
    matrix = torch.zeros(size + 1, size + 1, dtype=torch.float64, device=values.device)
    order = [*range(count), *range(count + 1, size + 1)]
    matrix[torch.tensor(order, device=matrix.device)[:, None], torch.tensor(order, device=matrix.device)] = at.full
    cross = torch.cat([shape @ own, (own @ own)[None], own @ rows[:, 1:]])
    matrix[count], matrix[:, count] = cross, cross
    return torch.linalg.inv(matrix)[: count + 1, : count + 1]
