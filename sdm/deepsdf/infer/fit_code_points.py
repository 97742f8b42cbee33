"""Fit of a DeepSDF's whole code, size and pose to points of a surface, from a fit of its components on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from sdm.core.random import generator
from sdm.deepsdf.infer.code_steps import CodeUnknowns, Slopes, WholeCode, conjugate_gradients, prior_deviations
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend
from sdm.fit.model.pose import State
from sdm.fit.solve.fit_points import OUTLIER

STEPS, HALVED = 15, 3
# Steps end where the objective falls by less than this [nats].
ENOUGH = 0.1
# Draws by which the numbers that points determine are counted, and the share of all points that they are at most.
DRAWS, MOST = 2, 0.9


@dataclass(frozen=True, eq=False)
class CodePointFit:
    """A whole code of points.

    Args:
        code: (D,) float32.
        state: Pose, with theta (1,) the size.
        noise: Standard deviation of the points' distances from the shape, less what the code took of them.
        mean_distance: Mean absolute distance of the points from the shape.
        determined: Numbers of the code and the pose that the points determine, and not the prior.
    """

    code: Tensor
    state: State
    noise: float
    mean_distance: float
    determined: float


def fit_code_points(
    points: Tensor,
    backend: DeepSDFBackend,
    start: State,
    *,
    noise: float,
    turn: float = 0.5,
    shift: float | None = None,
) -> CodePointFit:
    """Fit all numbers of a code, and size and pose again, to points (N,3) float64 of the surface.

    Args:
        points: In the unit of the training's meshes times the backend's factor, on its device.
        backend: The network.
        start: A state of the backend, as a fit of its components leaves it.
        noise: Standard deviation of the points about that.
        turn: Standard deviation of the rotation about the start [rad].
        shift: Of the translation; by default a tenth of the size.

    The maximum of the posterior density under the Gaussian of the training's codes. A code has more numbers than there
    are points, and would take their noise for shape, the more the less noise there is thought to be: the noise is
    estimated as in restricted maximum likelihood, from residuals over the points less the numbers that they determine.
    """
    shift = backend.factor * float(start.theta[0]) / 10 if shift is None else shift
    unknowns = CodeUnknowns(backend, start, prior_deviations(backend, turn, shift))
    floor = 1e-4 * unknowns.radius(unknowns.start)
    at, noise, determined = unknowns.start, max(noise, floor), 0.0
    slopes = unknowns.slopes(at, points)
    for number in range(STEPS):
        pull = _pull(slopes.values, noise)
        normal = partial(_normal, unknowns, at, slopes, pull)
        step = conjugate_gradients(normal, -unknowns.backward(slopes, at, pull * slopes.values) - unknowns.away(at))
        before, fell = _objective(unknowns, at, slopes.values, noise), 0.0
        for _ in range(HALVED):
            moved = unknowns.moved(at, step)
            there = unknowns.slopes(moved, points)
            fell = before - _objective(unknowns, moved, there.values, noise)
            if fell > 0:
                at, slopes = moved, there
                break
            step = step / 2
        determined = _determined(unknowns, at, slopes, noise, number)
        last = noise
        left = 1 - min(determined / len(points), MOST)
        noise = max(1.4826 * float(slopes.values.abs().median()) / left**0.5, floor)
        if fell < ENOUGH and abs(noise / last - 1) < 0.02:
            break
    return CodePointFit(unknowns.code(at), at.state, noise, float(slopes.values.abs().mean()), determined)


def _normal(unknowns: CodeUnknowns, at: WholeCode, slopes: Slopes, pull: Tensor, step: Tensor) -> Tensor:
    """The objective's curvature (Gauss-Newton's) times a step."""
    return unknowns.backward(slopes, at, pull * unknowns.forward(slopes, at, step)) + step


def _pull(distances: Tensor, noise: float) -> Tensor:
    """Weights (N,) of points: outliers pull no more strongly than others (Huber 1964)."""
    return (OUTLIER * noise / distances.abs().clamp_min(1e-30)).clamp_max(1.0) / noise**2


def _objective(unknowns: CodeUnknowns, at: WholeCode, distances: Tensor, noise: float) -> float:
    away = distances.abs() / noise
    huber = torch.where(away < OUTLIER, away**2 / 2, OUTLIER * away - OUTLIER**2 / 2)
    return float(huber.sum()) + 0.5 * float(unknowns.away(at).square().sum())


def _determined(unknowns: CodeUnknowns, at: WholeCode, slopes: Slopes, noise: float, number: int) -> float:
    """Trace of the matrix that takes points' distances to those that the fit explains, by random signs."""
    pull, total = _pull(slopes.values, noise), 0.0

    normal = partial(_normal, unknowns, at, slopes, pull)
    for draw in range(DRAWS):
        signs = torch.randn(len(pull), generator=generator(number, "signs of points", draw), dtype=torch.float64)
        signs = signs.sign().to(pull.device)
        right = unknowns.backward(slopes, at, pull.sqrt() * signs)
        total += float(right @ conjugate_gradients(normal, right))
    return total / DRAWS
