"""Damped Gauss-Newton steps on shape and pose, with the appearance estimated between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.fit.model.appearance import Appearance
from sdm.fit.model.partial_volume import Rendered
from sdm.fit.model.pose import State
from sdm.fit.model.prior import Prior

# Renders states on an image's grid, with derivatives: `Renderer`, `Anchored`.
Render = Callable[[State], Rendered]

# Steps of expectation-maximisation for each step of shape and pose.
EM_STEPS = 2
DAMPING = 1e-3
MOST_DAMPING = 1e6
# Below steps of this many posterior standard deviations, facets make the objective rough by so many nats: steps are
# then taken as they come, and where they get no shorter the search has converged as far as it can.
FLAT, ROUGHNESS, PATIENCE = 0.2, 0.01, 2


@dataclass(frozen=True, eq=False)
class Point:
    """A state with all that is known there.

    Args:
        state: Shape and pose.
        appearance: The appearance estimated there.
        objective: Minus the log posterior density, but for a constant.
        gradient: (P+6,) of the objective.
        curvature: (P+6,P+6) its second derivative, with the mean intensities integrated out.
        full: (P+6+K,P+6+K) the same with the K mean intensities.
        share: (nx,ny,nz) share of inside.
    """

    state: State
    appearance: Appearance
    objective: float
    gradient: Tensor
    curvature: Tensor
    full: Tensor
    share: Tensor


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of the steps.

    Args:
        point: The last state.
        converged: The next step would have been shorter than the tolerance.
        left: Length of the next step in posterior standard deviations.
        steps: How many were tried.
        objectives: At the start and after each step that was taken, each with the appearance estimated there.
    """

    point: Point
    converged: bool
    left: float
    steps: int
    objectives: tuple[float, ...]


def evaluate(
    renderer: Render, image: Tensor, state: State, appearance: Appearance, prior: Prior, em_steps: int = EM_STEPS
) -> Point:
    """The objective at a state, and its first two derivatives."""
    return differentiate(renderer(state), image, state, appearance, prior, em_steps)


def held_objective(rendered: Rendered, image: Tensor, state: State, appearance: Appearance, prior: Prior) -> float:
    """The objective at a state with the noise and the weights of another one; mean intensities follow the state.

    Steps are judged by it. The partial volume model's variances are moments of the residuals, no maximum of the
    likelihood, so the objective with variances estimated at each state is not the one whose gradient is known: where
    the residuals are misfit rather than noise a step that goes down by the one can go up by the other.
    """
    voxels, share = image.flatten(), rendered.share.flatten()
    for _ in range(EM_STEPS):
        appearance = appearance.with_means(voxels, share)
    return prior.penalty(state) - appearance.evidence(voxels, share).log_likelihood


def differentiate(
    rendered: Rendered, image: Tensor, state: State, appearance: Appearance, prior: Prior, em_steps: int
) -> Point:
    """The objective at a state that is rendered, with the appearance estimated there, and its first two derivatives."""
    assert rendered.by_step is not None  # noqa: S101 - for the type checker
    voxels, share = image.flatten(), rendered.share.flatten()
    for _ in range(em_steps):
        appearance = appearance.update(voxels, share)
    evidence = appearance.evidence(voxels, share)
    by_step = rendered.by_step.flatten(1)
    # Voxels away from the surface say nothing of the shape, but all say something of the intensities.
    near = (by_step != 0).any(0).nonzero()[:, 0]
    jacobian = by_step[:, near].double()
    count = jacobian.shape[0]
    residual = prior.residual(state)
    gradient = -jacobian @ evidence.slope[near] + prior.precision * residual
    rows = evidence.rows[near]
    shape = jacobian * rows[:, 0]
    full = torch.zeros([count + rows.shape[1] - 1] * 2, dtype=torch.float64, device=share.device)
    full[:count, :count] = shape @ shape.T + prior.precision.diag()
    full[:count, count:] = shape @ rows[:, 1:]
    full[count:, :count] = full[:count, count:].T
    full[count:, count:] = evidence.rows[:, 1:].T @ evidence.rows[:, 1:]
    objective = -evidence.log_likelihood + prior.penalty(state)
    return Point(state, appearance, objective, gradient, marginal(full, count), full, rendered.share)


def marginal(full: Tensor, count: int) -> Tensor:
    """The information on the first `count` unknowns when the others are unknown too: the Schur complement."""
    cross, rest = full[:count, count:], full[count:, count:]
    rest = rest + 1e-12 * rest.diagonal().max().clamp_min(1e-30) * torch.eye(len(rest), device=rest.device).double()
    return full[:count, :count] - cross @ torch.linalg.solve(rest, cross.T)


def minimise(
    renderer: Render,
    image: Tensor,
    start: State,
    appearance: Appearance,
    prior: Prior,
    *,
    most_steps: int,
    tolerance: float,
    report: Callable[[int, Point], None] | None = None,
) -> Outcome:
    """Go down from `start`.

    Args:
        renderer: Renders states on the image's grid.
        image: (nx,ny,nz) float64 intensities.
        start: Where to begin.
        appearance: The first guess at the appearance.
        prior: What is believed of shape and pose.
        most_steps: Give up after so many steps that were tried.
        tolerance: Converged once the next step is shorter than this many posterior standard deviations.
        report: Called with the number of each step and where it led.
    """
    at = evaluate(renderer, image, start, appearance, prior, em_steps=2 * EM_STEPS)
    objectives, damping = [at.objective], DAMPING
    shortest, waited, length = float("inf"), 0, _length(at, prior)
    for number in range(1, most_steps + 1):
        waited = 0 if length < 0.5 * shortest or length > FLAT else waited + 1
        shortest = min(shortest, length)
        if length < tolerance or waited > PATIENCE:
            return Outcome(at, True, length, number - 1, tuple(objectives))
        state = at.state.moved(_step(at, prior, damping))
        rendered = renderer(state)
        held = held_objective(rendered, image, state, at.appearance, prior)
        if held < at.objective + (ROUGHNESS if length < FLAT else 0.0):
            at, damping = differentiate(rendered, image, state, at.appearance, prior, EM_STEPS), max(damping / 10, 1e-9)
            objectives.append(at.objective)
            length = _length(at, prior)
        elif damping >= MOST_DAMPING:
            return Outcome(at, False, length, number, tuple(objectives))
        else:
            damping = max(10 * damping, DAMPING)
        if report is not None:
            report(number, at)
    return Outcome(at, False, length, most_steps, tuple(objectives))


def _length(at: Point, prior: Prior) -> float:
    """Length of the full step from a point in posterior standard deviations."""
    newton = _step(at, prior, 0.0)
    return float((newton @ at.curvature @ newton).clamp_min(0).sqrt())


def _step(at: Point, prior: Prior, damping: float) -> Tensor:
    """A damped Gauss-Newton step that stays in the ranges."""
    free = torch.ones(len(at.gradient), dtype=torch.bool, device=at.gradient.device)
    step = torch.zeros_like(at.gradient)
    for _ in range(len(prior.low) + 1):
        matrix = at.curvature[free][:, free]
        matrix = matrix + damping * matrix.diagonal().diag()
        step = torch.zeros_like(at.gradient)
        step[free] = -torch.linalg.solve(matrix, at.gradient[free])
        stuck = prior.blocked(at.state, step) & free
        if not bool(stuck.any()):
            break
        free = free & ~stuck
    return prior.clip(at.state, step)
