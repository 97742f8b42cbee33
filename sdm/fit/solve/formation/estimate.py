"""Shape, pose, blur and uneven intensities at their joint optimum, with intervals that hold for correlated noise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.errors import SDMError
from sdm.fit.model.appearance import Mixture, PartialVolume
from sdm.fit.model.backend import Backend
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.model.prior import Prior
from sdm.fit.solve.diagnosis import diagnose
from sdm.fit.solve.fit_shape import FitOptions, image_tensor, prior_of, renderer_of
from sdm.fit.solve.formation.discretisation import Discretisation, discretisation
from sdm.fit.solve.formation.intensity_field import Intensities, polynomials
from sdm.fit.solve.formation.noise_correlation import Lag, autocorrelation, correlated_information, effective_share
from sdm.fit.solve.formation.predictive_check import predictive_p
from sdm.fit.solve.posterior import Posterior
from sdm.fit.solve.result import FitResult, Formation
from sdm.fit.solve.solver import FLAT, PATIENCE, ROUGHNESS, Outcome, Point

# Steps; the length of a step, in posterior standard deviations, after which the discretisation's error is taken out,
# and that which ends them; halvings of a step that goes up.
MOST_STEPS, NEAR, STILL, HALVINGS = 15, 0.5, 0.02, 5
# Prior of the logarithm of the blur about the one that is named, and relative change for its derivative.
BLUR_SPREAD, BLUR_STEP = 0.7, 0.02
# The model does not describe the image where the check's p is below the one, and the residuals at the surface that
# noise does not explain are beyond the other, as a share of the contrast: facets alone leave less.
LEAST_P, MATERIAL = 1e-3, 0.05


@dataclass(frozen=True, eq=False)
class _At:
    """A state with its objective and the derivatives of the shares of inside."""

    state: State
    log_blur: float
    seen: _Seen
    intensities: Intensities
    objective: float

    @property
    def share(self) -> Tensor:
        """(N,) share of inside."""
        return self.seen.share

    def rows(self) -> Tensor:
        """(P+7,N) derivatives of the expected intensities by shape, pose and log blur."""
        return self.seen.by_unknown * self.intensities.contrast()


@dataclass(frozen=True, eq=False)
class _Seen:
    """Voxels' shares of inside under a blur, and their derivatives."""

    share: Tensor  # (N,)
    by_unknown: Tensor  # (P+7,N) by shape, pose and log blur

    def corrected(self, correction: Tensor) -> _Seen:
        """The same with a correction (N,) of the shares."""
        return replace(self, share=self.share + correction)


def _seen(renderer: Renderer, blur: float, state: State) -> _Seen:
    """Voxels of a state by a renderer of this blur: its sample points are looked up once for all derivatives."""
    samples = renderer.sampled(state)
    rendered = renderer.rendered(samples)
    assert rendered.by_step is not None  # noqa: S101 - for the type checker
    more, less = (renderer.with_blur(blur * math.exp(s)).blurred(samples.share) for s in (BLUR_STEP, -BLUR_STEP))
    by_blur = ((more - less) / (2 * BLUR_STEP)).flatten()
    by_unknown = torch.cat([rendered.by_step.flatten(1).double(), by_blur[None]])
    return _Seen(rendered.share.flatten(), by_unknown)


def estimate_formation(
    image: Any,
    grid: GridLike,
    backend: Backend,
    result: FitResult,
    options: FitOptions,
    *,
    degree: int = 1,
    report: Callable[[str, int], None] | None = None,
) -> FitResult:
    """Go on from a fit with the image's formation as further unknowns.

    Args:
        image: As `fit_shape` had it.
        grid: As `fit_shape` had it.
        backend: Exact distances.
        result: Its result.
        options: Its options: "partial-volume", one component inside and one outside, a blur above 0.
        degree: Of the polynomials by which intensities inside and outside may change over the image; 0: even.
        report: Called with "formation" and the number of each step, first of all with 0.

    Returns:
        The result at the joint optimum of shape, pose, blur and intensities. Its covariance has the others integrated
        out and holds for the noise's correlation as the residuals show it, and is widened where the surface is seen
        less well than the noise lets expect. `result.formation` says what was found.
        A hopeless result comes back as it is. One is not trusted where a
        posterior predictive check says that the model does not describe the image.

    Raises:
        SDMError: Another model, or a degree below 0 or above 3.
    """
    if options.model != "partial-volume" or options.components != (1, 1) or not options.blur > 0:
        raise SDMError(
            "the image's formation is estimated for the model partial-volume, one component inside and one outside, "
            "and from a blur above 0"
        )
    if not 0 <= degree <= 3:
        raise SDMError(f"degree is {degree}; the polynomials of the intensities have degree 0 to 3")
    if result.diagnosis.hopeless:
        return result
    grid = as_grid(grid)
    values = image_tensor(image, grid, backend.device)
    prior = prior_of(grid, backend, options)
    voxels, named = values.flatten(), math.log(options.blur)

    basis = polynomials(grid.shape, degree, values.device)
    means = torch.zeros(2 * basis.shape[1], dtype=torch.float64, device=values.device)
    means[0], means[basis.shape[1]] = result.appearance.inside.mean, result.appearance.outside.mean
    noise = (result.appearance.inside.deviation**2, result.appearance.outside.deviation**2)
    begun = Intensities(basis, means, noise, result.appearance.least)
    start = math.log(result.blur[0]) if result.blur is not None else named
    error: Discretisation | None = None
    told, numbers = report or (lambda *_: None), itertools.count()
    told("formation", next(numbers))

    def evaluate(state: State, log_blur: float, seen: _Seen, intensities: Intensities) -> _At:
        objective = _objective(voxels, seen.share, intensities, state, log_blur)
        return _At(state, log_blur, seen, intensities, objective)

    def with_noise(at: _At) -> _At:
        it = at.intensities
        for _ in range(2):
            it = it.with_noise(voxels, at.share).fitted(voxels, at.share)
        return evaluate(at.state, at.log_blur, at.seen, it)

    def tried(state: State, log_blur: float, intensities: Intensities) -> _At:
        blur = math.exp(log_blur)
        seen = _seen(renderer_of(grid, backend, replace(options, blur=blur)), blur, state)
        seen = seen if error is None else seen.corrected(error.correction)
        return evaluate(state, log_blur, seen, intensities.fitted(voxels, seen.share))

    def _objective(voxels: Tensor, share: Tensor, it: Intensities, state: State, log_blur: float) -> float:
        variance = it.variance(share)
        fit = 0.5 * float(((voxels - it.design(share) @ it.coefficients) ** 2 / variance + variance.log()).sum())
        uneven = 0.5 * float((it.precision() * it.coefficients**2).sum())
        return fit + uneven + prior.penalty(state) + 0.5 * ((log_blur - named) / BLUR_SPREAD) ** 2

    def descended(at: _At, still: float) -> tuple[_At, Tensor, float, bool, int]:
        """The last state, its information, the length of the step that is left, whether it converged, and steps."""
        steps, shortest, waited = 0, math.inf, 0
        while True:
            full, gradient = _normal(at, voxels, prior, named)
            step = _step(full, gradient, at.state, prior)
            length = float((step @ full @ step).clamp_min(0).sqrt())
            waited = 0 if length < 0.5 * shortest or length > FLAT else waited + 1
            shortest, converged = min(shortest, length), length < still or waited > PATIENCE
            ends = converged or steps >= MOST_STEPS
            lower = None if ends else _down(at, step[: len(at.seen.by_unknown)], prior, tried)
            if lower is None:
                return at, full, length, converged, steps
            at, steps = with_noise(lower), steps + 1
            told("formation", next(numbers))

    at, _, _, _, before = descended(with_noise(tried(result.state, start, begun)), NEAR)
    # Far below the noise of most images, and far above the intervals of those with next to none.
    error = discretisation(grid, backend, replace(options, blur=math.exp(at.log_blur)), at.state, at.share)
    at = with_noise(evaluate(at.state, at.log_blur, at.seen.corrected(error.correction), at.intensities))
    at, full, length, converged, after = descended(at, STILL)
    return _finished(values, grid, result, prior, backend, at, error, full, length, converged, before + after)


def _down(at: _At, step: Tensor, prior: Prior, tried: Callable[[State, float, Intensities], _At]) -> _At | None:
    """The step, or a half, quarter, ... of it, that does not go up by the noise as it was."""
    for halving in range(HALVINGS):
        part = step / 2**halving
        blur = at.log_blur + max(-0.5, min(0.5, float(part[-1])))
        found = tried(at.state.moved(prior.clip(at.state, part[:-1])), blur, at.intensities)
        if found.objective < at.objective + ROUGHNESS:
            return found
    return None


def _normal(at: _At, voxels: Tensor, prior: Prior, named: float) -> tuple[Tensor, Tensor]:
    """Information (K,K) of all unknowns, intensities last, and the objective's gradient (K,)."""
    rows, design = at.rows(), at.intensities.design(at.share)
    every = torch.cat([rows, design.T])
    weight = 1 / at.intensities.variance(at.share)
    own = torch.cat([prior.precision, _number(1 / BLUR_SPREAD**2, rows), at.intensities.precision()])
    full = (every * weight) @ every.T + own.diag()
    residual = voxels - design @ at.intensities.coefficients
    away = torch.cat([prior.residual(at.state), _number(at.log_blur - named, rows), at.intensities.coefficients])
    return full, -every @ (weight * residual) + own * away


def _number(value: float, like: Tensor) -> Tensor:
    return torch.tensor([value], dtype=like.dtype, device=like.device)


def _step(full: Tensor, gradient: Tensor, state: State, prior: Prior) -> Tensor:
    """The Gauss-Newton step (K,); shape parameters at an end of their range stay there."""
    free = torch.ones(len(gradient), dtype=torch.bool, device=gradient.device)
    step = torch.zeros_like(gradient)
    count = len(prior.precision)
    for _ in range(len(prior.low) + 1):
        step = torch.zeros_like(gradient)
        step[free] = -torch.linalg.solve(full[free][:, free], gradient[free])
        stuck = torch.zeros_like(free)
        stuck[:count] = prior.blocked(state, step[:count]) & free[:count]
        if not bool(stuck.any()):
            break
        free = free & ~stuck
    return step


def _finished(
    values: Tensor, grid: Any, result: FitResult, prior: Prior, backend: Backend, at: _At,
    error: Discretisation, full: Tensor, length: float, converged: bool, steps: int,
) -> FitResult:  # fmt: skip
    rows = at.rows()
    shape, count = values.shape, rows.shape[0]
    it = at.intensities
    design, deviation = it.design(at.share), it.variance(at.share).sqrt()
    expected = (design @ it.coefficients).view(shape)
    residual = (values - expected) / deviation.view(shape)
    lags: dict[Lag, float] = autocorrelation(residual)
    near = ((at.share > 0.02) & (at.share < 0.98)).view(shape)
    p, excess = predictive_p(residual, near, count, lags)
    scaled = (torch.cat([rows, design.T]) / deviation).view(-1, *shape)
    # Beyond the noise that is taken for granted, which may be more than there is elsewhere.
    level = float((residual[near] ** 2).sum()) / max(1, int(near.sum()) - count)
    if excess > 1 and level > 1:
        scaled = scaled * torch.where(near, math.sqrt(min(excess, level)), 1.0)
    white = full - (torch.cat([rows, design.T]) / deviation**2) @ torch.cat([rows, design.T]).T
    inverse = torch.linalg.inv(full)
    covariance = inverse @ (correlated_information(scaled, lags) + white) @ inverse
    covariance = _not_narrower(covariance, inverse) if lags else covariance
    # Shares that are off, in intensities, by their weights.
    felt = torch.cat([rows, design.T]) * (it.contrast() / it.variance(at.share))
    covariance = (covariance + inverse @ error.score(felt.view(-1, *shape)) @ inverse)[:count, :count]

    # The image as it were with even intensities, for the checks that know of no others.
    inside, outside = (float((w * (it.basis @ c)).sum() / w.sum().clamp_min(1e-12)) for w, c in zip(
        (at.share, 1 - at.share), it.coefficients.chunk(2), strict=True))  # fmt: skip
    share = at.share.view(shape)
    even = values - expected + share * inside + (1 - share) * outside
    parts = [_gaussian(m, v, share) for m, v in zip((inside, outside), it.variances, strict=True)]
    appearance = PartialVolume(parts[0], parts[1], it.least)
    body = count - 1
    point = Point(at.state, appearance, at.objective, full[:body, 0] * 0, full[:body, :body], full, share)
    names = [q.name for q in backend.parameters]
    told = diagnose(even, grid, Outcome(point, converged, length, steps, ()), prior, names)
    contrast = abs(inside - outside)
    noise = float(residual[~near].std()) * float(deviation.view(shape)[near].mean()) if bool(near.any()) else 0.0
    left = noise * math.sqrt(max(0.0, excess - 1)) / max(contrast, 1e-300)
    # Told by the check instead, which knows of correlated noise.
    warnings = tuple(w for w in told.warnings if not w.startswith("the image differs"))
    problems = told.problems
    if p < LEAST_P and left > MATERIAL:
        sentence = (
            f"the model does not describe the image: its residuals at the surface, beyond the noise, are {left:.1%} "
            f"of the contrast (p = {p:.2g})"
        )
        problems = (*problems, sentence)
    blur = math.exp(at.log_blur)
    found = Formation(
        blur=(blur, blur * float(covariance[body, body].clamp_min(0).sqrt())),
        effective_share=effective_share(lags),
        coefficients=it.coefficients,
        expected=expected,
        p_value=p,
        unexplained=left,
    )
    return replace(
        result,
        posterior=Posterior(at.state, covariance[:body, :body]),
        appearance=appearance,
        share=share,
        objective=at.objective,
        diagnosis=replace(told, problems=problems, warnings=warnings),
        steps={**result.steps, "formation": steps},
        blur=found.blur,
        formation=found,
    )


def _not_narrower(found: Tensor, white: Tensor) -> Tensor:
    """A covariance whose variances are no smaller than white noise's: negative correlations are not banked on."""
    more = (white.diagonal() / found.diagonal().clamp_min(1e-300)).clamp_min(1.0).sqrt()
    return found * more * more[:, None]


def _gaussian(mean: float, variance: float, like: Tensor) -> Mixture:
    one = [torch.tensor([x], dtype=torch.float64, device=like.device) for x in (1.0, mean, variance)]
    return Mixture(one[0], one[1], one[2])
