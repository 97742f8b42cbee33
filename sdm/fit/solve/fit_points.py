"""Fit of a family to points of a surface: Gauss-Newton steps on their exact distances from the shape."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm.errors import SDMError
from sdm.fit.model.backend import Backend
from sdm.fit.model.pose import State, rotation_from_vector
from sdm.fit.model.prior import Prior
from sdm.fit.solve.diagnosis import at_ends
from sdm.fit.solve.point_misfit import shared_distance
from sdm.fit.solve.posterior import Posterior
from sdm.runtime.threads import one_thread_for
from sdm.shapes import Parameter

FEWEST, MOST = 20, 200_000
STEPS, FIRST_STEPS, TOLERANCE = 60, 8, 1e-3
# Deviations of the noise beyond which a point pulls no more strongly (Huber 1964).
OUTLIER = 2.5
# Starts: the expected rotation, and one either way about each axis.
TURNED = 0.8


@dataclass(frozen=True, eq=False)
class PointFit:
    """Shape and pose of points.

    Args:
        posterior: The Laplace approximation about the estimate; its covariance is that of independent points.
        noise: Standard deviation of the points' distances from the shape, outliers weighed less.
        mean_distance: Mean absolute distance of the points from the shape.
        converged: The last step was far below the posterior's standard deviations.
        steps: Steps from the best of the starts' first ones.
        misfit: Root mean square of what neighbouring points' distances have alike, in the points' unit; 0 where
            independent noise explains them.
    """

    posterior: Posterior
    noise: float
    mean_distance: float
    converged: bool
    steps: int
    misfit: float = 0.0

    def record(self, parameters: Sequence[Parameter], level: float = 0.9) -> dict[str, Any]:
        """Everything as plain numbers, for JSON."""
        state, ends = self.posterior.state, self.posterior.intervals(level).tolist()
        deviations = self.posterior.deviations.tolist()
        return {
            "theta": {
                p.name: {"estimate": float(v), "deviation": d, "interval": e, "unit": p.unit}
                for p, v, d, e in zip(parameters, state.theta, deviations, ends, strict=False)
            },
            "level": level,
            "pose": {
                "rotation": state.rotation.tolist(),
                "translation": state.translation.tolist(),
                "centre": state.centre.tolist(),
            },
            "noise": self.noise,
            "mean_distance": self.mean_distance,
            "converged": self.converged,
            "steps": self.steps,
            "misfit": self.misfit,
            "warnings": self.warnings(parameters),
        }

    def warnings(self, parameters: Sequence[Parameter]) -> list[str]:
        """Sentences about points that the shape does not explain, and parameters at an end of their ranges."""
        values = self.posterior.state.theta.tolist()
        names, low, high = [p.name for p in parameters], [p.low for p in parameters], [p.high for p in parameters]
        found = at_ends(names, values, low, high)
        if self.misfit > 0:
            found.append(
                f"neighbouring points are off the shape alike, by {self.misfit:.3g}, as independent noise is not, so "
                "the intervals are too narrow: the points may be of no shape of this family, or turned further (--turn)"
            )
        return found


def fit_points(
    points: Any,
    backend: Backend,
    *,
    turn: float = 0.5,
    shift: float | None = None,
    report: Callable[[str, int], None] | None = None,
) -> PointFit:
    """Fit shape and pose to points (N,3) that lie on the surface, but for noise, and see most of it.

    Args:
        points: In the family's unit; 20 or more.
        backend: Exact distances of the family.
        turn: How far the shape may be turned from its own frame, standard deviation about each axis [rad].
        shift: How far its middle may be from that of the points, standard deviation along each axis; by default a
            quarter of the points' extent.
        report: Called with the stage's name and the number of each step, first of all with 0.

    Returns:
        The best of seven starts. The noise is estimated with the shape; points are taken to be independent, so
        intervals are too narrow where they are not.

    Raises:
        SDMError: Too few or too many points, or one that is not finite.
    """
    given = torch.as_tensor(np.asarray(points) if not isinstance(points, Tensor) else points)
    if given.ndim != 2 or given.shape[1] != 3 or not FEWEST <= len(given) <= MOST:
        raise SDMError(f"points have shape {tuple(given.shape)}; (N, 3) with {FEWEST} to {MOST:,} points is needed")
    given = given.to(backend.device, torch.float64)
    if not bool(given.isfinite().all()):
        raise SDMError("a point is not finite: mend or leave out such points")
    extent = float((given.amax(0) - given.amin(0)).max())
    if extent == 0:
        raise SDMError("all points are at one place")
    middle = (given.amax(0) + given.amin(0)) / 2
    theta = torch.tensor([(p.low + p.high) / 2 for p in backend.parameters], dtype=torch.float64, device=given.device)
    pose = State(theta, torch.eye(3, dtype=torch.float64, device=given.device), middle, backend.centre.to(given))
    prior = Prior.of(backend.parameters, pose, turn, shift or extent / 4)
    turns = [torch.zeros(3, device="cpu")] + [
        s * TURNED * turn * torch.eye(3, device="cpu")[axis] for axis in range(3) for s in (-1.0, 1.0)
    ]
    with one_thread_for(len(given), given.device):
        best: tuple[float, State] | None = None
        for number, vector in enumerate(turns, 1):
            start = State(theta, rotation_from_vector(vector.to(given)), middle, pose.centre)
            told = None if report is None else partial(report, f"start {number} of {len(turns)}")
            objective, fit = _search(given, backend, prior, start, extent, FIRST_STEPS, told)
            if best is None or objective < best[0]:
                best = objective, fit.posterior.state
        assert best is not None  # noqa: S101 - there is always a start
        told = None if report is None else partial(report, "shape and pose")
        _, fit = _search(given, backend, prior, best[1], extent, STEPS, told)
        state = fit.posterior.state
        inside = state.to_shape(given)
        found = backend.with_derivatives(state.theta, inside)
        feet = inside - found.values[:, None] * found.by_point
    return replace(fit, misfit=shared_distance(feet, found.values, fit.noise))


def _search(
    points: Tensor,
    backend: Backend,
    prior: Prior,
    state: State,
    extent: float,
    most: int,
    report: Callable[[int], None] | None,
) -> tuple[float, PointFit]:
    """The optimum from one start, and minus its log posterior density."""
    if report is not None:
        report(0)
    damping, at = 1e-3, _weighed(*_looked_up(points, backend, state), prior, state, extent)
    converged, steps = False, 0
    while steps < most:
        steps += 1
        if report is not None:
            report(steps)
        objective, gradient, curvature, noise, _ = at
        matrix = curvature + damping * curvature.diagonal().diag()
        step = _bounded(matrix, gradient, prior, state)
        length = float((step @ curvature @ step).clamp_min(0).sqrt())
        if length < TOLERANCE:
            converged = True
            break
        moved = state.moved(step)
        found = _looked_up(points, backend, moved)
        # Judged with the noise of the state it started from.
        if _objective(found[0], noise, prior, moved) < objective:
            state, damping = moved, max(damping / 10, 1e-9)
            at = _weighed(*found, prior, state, extent)
        elif damping > 1e6:
            converged = length < 0.1
            break
        else:
            damping *= 10
    objective, _, curvature, noise, distances = at
    fit = PointFit(
        Posterior(state, torch.linalg.inv(curvature)), noise, float(distances.abs().mean()), converged, steps
    )
    return objective, fit


Evaluated = tuple[float, Tensor, Tensor, float, Tensor]


def _looked_up(points: Tensor, backend: Backend, state: State) -> tuple[Tensor, Tensor]:
    """Distances (N,) of points from the shape at a state, and their derivatives (N,P+6) by its increments."""
    inside = state.to_shape(points)
    found = backend.with_derivatives(state.theta, inside)
    return found.values, state.chain(inside, found.by_theta, found.by_point)


def _weighed(d: Tensor, jacobian: Tensor, prior: Prior, state: State, extent: float) -> Evaluated:
    """Objective, gradient, curvature, noise and distances: the noise is that of the distances."""
    # 1.4826 makes the median deviation that of a Gaussian; outliers have no say in it.
    noise = max(1.4826 * float(d.abs().median()), 1e-5 * extent)
    pull = (OUTLIER * noise / d.abs().clamp_min(1e-30)).clamp_max(1.0) / noise**2
    residual = prior.residual(state)
    gradient = jacobian.T @ (pull * d) + prior.precision * residual
    curvature = (jacobian.T * pull) @ jacobian + prior.precision.diag()
    return _objective(d, noise, prior, state), gradient, curvature, noise, d


def _objective(d: Tensor, noise: float, prior: Prior, state: State) -> float:
    away = d.abs() / noise
    huber = torch.where(away < OUTLIER, away**2 / 2, OUTLIER * away - OUTLIER**2 / 2)
    return float(huber.sum()) + len(d) * math.log(noise) + prior.penalty(state)


def _bounded(matrix: Tensor, gradient: Tensor, prior: Prior, state: State) -> Tensor:
    """The step that leaves no range."""
    free = torch.ones(len(gradient), dtype=torch.bool, device=gradient.device)
    step = torch.zeros_like(gradient)
    for _ in range(len(prior.low) + 1):
        step = torch.zeros_like(gradient)
        step[free] = -torch.linalg.solve(matrix[free][:, free], gradient[free])
        stuck = prior.blocked(state, step) & free
        if not bool(stuck.any()):
            break
        free = free & ~stuck
    count = len(prior.low)
    theta = (state.theta + step[:count]).clamp(prior.low, prior.high)
    return torch.cat([theta - state.theta, step[count:].clamp(-prior.shift, prior.shift)])
