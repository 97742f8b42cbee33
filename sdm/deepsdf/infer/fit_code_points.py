"""Fit of a DeepSDF's whole code, size and pose to points of a surface, from a fit of its components on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from sdm.deepsdf.infer.code_steps import SLOPE, CodeUnknowns, Evenness, Slopes, WholeCode, prior_deviations
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend
from sdm.fit.model.pose import State
from sdm.fit.solve.fit_points import OUTLIER

STEPS, HALVED = 12, 3
# Steps end where the noise changes by less than this share.
SETTLED = 0.01
# Noise [radii] below which no network is exact, nor the points' own space in float32.
FLOOR, ROUNDING = 1e-3, 1e-6
# The share of the points that a code determines at most.
MOST = 0.9


@dataclass(frozen=True, eq=False)
class CodePointFit:
    """A whole code of points.

    Args:
        code: (D,) float32.
        state: Pose, with theta (1,) the size.
        noise: Standard deviation of the points' distances from the shape, with what the code took of them.
        mean_distance: Mean absolute distance of the points from the shape.
        determined: Numbers that the points determine, and not the prior.
        converged: The noise has settled.
        steps: That were taken.
    """

    code: Tensor
    state: State
    noise: float
    mean_distance: float
    determined: float
    converged: bool
    steps: int

    def record(self) -> dict[str, Any]:
        """Plain numbers, for JSON."""
        return {
            "numbers": len(self.code),
            "size": float(self.state.theta[0]),
            "rotation": self.state.rotation.tolist(),
            "translation": self.state.translation.tolist(),
            "noise": self.noise,
            "mean_distance": self.mean_distance,
            "determined": self.determined,
            "converged": self.converged,
            "steps": self.steps,
        }


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points under a code."""

    slopes: Slopes
    even: Evenness

    def objective(self, unknowns: CodeUnknowns, at: WholeCode, noise: float) -> float:
        away = self.slopes.values.abs() / noise
        huber = torch.where(away < OUTLIER, away**2 / 2, OUTLIER * away - OUTLIER**2 / 2)
        return float(huber.sum()) + self.even.penalty + 0.5 * float(unknowns.away(at).square().sum())


def fit_code_points(
    points: Tensor,
    backend: DeepSDFBackend,
    start: State,
    *,
    noise: float,
    report: Callable[[str, int], None] | None = None,
) -> CodePointFit:
    """Fit all numbers of a code, and size and pose again, to points (N,3) float64 of the surface, a few thousand.

    Args:
        points: In the unit of the training's meshes times the backend's factor, on its device.
        backend: The network.
        start: A state of the backend, as a fit of its components leaves it.
        noise: Standard deviation of the points about that.
        report: Called with "code" and the number of each step.

    The maximum of the posterior density under the Gaussian of the training's codes. There are fewer points than numbers
    of a code, so steps are solved for in the points' own space: (J C J' + W^-1) y = r by Cholesky's factors, and the
    step is C J' y. A code would take the points' noise for shape, the more the less noise there is thought to be: the
    noise is estimated as in restricted maximum likelihood, from residuals over the points less the numbers that they
    determine, which is the trace of J C J' (J C J' + W^-1)^-1.
    """
    unknowns = CodeUnknowns(backend, start, prior_deviations(backend))
    floor = FLOOR * unknowns.radius(unknowns.start)
    at, noise, determined, converged, steps = unknowns.start, max(noise, floor), 0.0, False, 0
    seen = _look(unknowns, at, points)
    while steps < STEPS and not converged:
        steps += 1
        if report is not None:
            report("code", steps)
        step, determined = _step(unknowns, at, seen, noise)
        before = seen.objective(unknowns, at, noise)
        for _ in range(HALVED):
            moved = unknowns.moved(at, step)
            there = _look(unknowns, moved, points)
            if there.objective(unknowns, moved, noise) < before:
                at, seen = moved, there
                break
            step = step / 2
        left = 1 - min(determined / len(points), MOST)
        last, noise = noise, max(1.4826 * float(seen.slopes.values.abs().median()) / left**0.5, floor)
        converged = abs(noise / last - 1) < SETTLED
    mean = float(seen.slopes.values.abs().mean())
    return CodePointFit(unknowns.code(at), at.state, noise, mean, determined, converged, steps)


def _look(unknowns: CodeUnknowns, at: WholeCode, points: Tensor) -> _Seen:
    """The slope is looked at at every second point."""
    slopes = unknowns.slopes(at, points)
    return _Seen(slopes, Evenness(unknowns, at, points[::2], slopes.outward[::2]))


def _step(unknowns: CodeUnknowns, at: WholeCode, seen: _Seen, noise: float) -> tuple[Tensor, float]:
    """The Gauss-Newton step (D+7,), and how many numbers the points determine."""
    gaussian, values, count = unknowns.gaussian, seen.slopes.values, len(seen.slopes.values)
    own, others = seen.even.rows
    rows = torch.cat([unknowns.rows(seen.slopes, at), own])
    similar = torch.cat([seen.slopes.similar, others])
    along = rows @ gaussian.axes.T
    kernel = (gaussian.rest * (rows @ rows.T) + (along * (gaussian.variances - gaussian.rest)) @ along.T).double()
    kernel = kernel + similar @ similar.T
    # Outliers pull no more strongly than others (Huber 1964).
    weight = (OUTLIER * noise / values.abs().clamp_min(1e-30)).clamp_max(1.0) / noise**2
    weight = torch.cat([weight, torch.full_like(seen.even.residual, 1 / SLOPE**2)])
    factor = torch.linalg.cholesky(kernel + (1 / weight + ROUNDING * kernel.diagonal().mean()).diag())
    away = unknowns.away(at)
    taken = (rows @ gaussian.spread(away[:-7].float())).double() + similar @ away[-7:]
    residual = taken - torch.cat([values, seen.even.residual])
    pull = torch.cholesky_solve(residual[:, None], factor)[:, 0]
    best = torch.cat([gaussian.spread(rows.T @ pull.float()).double(), similar.T @ pull])
    left = torch.cholesky_inverse(factor).diagonal()[:count] / weight[:count]
    return best - away, count - float(left.sum())
