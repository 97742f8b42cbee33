"""Gauss-Newton steps on a whole code with size and pose, which has thousands of numbers.

The unknowns are standard ones: the code in coordinates in which those of the training shapes are a standard Gaussian
(`CodeGaussian`), and the increments of log size, rotation and translation in standard deviations of their priors. A
distance depends on a code by what its point sees of it, which is linear in the code (`seen` of the decoders), so one
pass back through the network gives all derivatives, a sparse matrix (`CodeJacobian`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import normalize

from sdm.deepsdf.infer.code_jacobian import CodeJacobian
from sdm.deepsdf.infer.fit_backend import POINTS, DeepSDFBackend, directions
from sdm.deepsdf.networks.code_gaussian import CodeGaussian
from sdm.deepsdf.networks.decoders import Decoder
from sdm.fit.model.pose import State, vector_from_rotation
from sdm.runtime.threads import threads

# Variance of what the training's codes leave open, as a share of theirs: a shape that was left out is half outside.
OPEN = 1.0
# Deviations of log size and rotation about the start: a whole code has sizes and turns of its own, and would drift.
HELD_SIZE, HELD_TURN = 0.02, 0.05
# Deviation of the slope of the distance along its gradient, and the way over which it is measured, in radii. Codes
# away from those of the training have slopes other than 1, and values near 0 that are no small distances.
SLOPE, WAY = 0.1, 0.03


@dataclass(frozen=True, eq=False)
class WholeCode:
    """A whole code with its size and pose.

    Args:
        standard: (D,) float64 the code in the coordinates of `CodeGaussian`.
        state: Its pose, with theta (1,) the size.
    """

    standard: Tensor
    state: State


@dataclass(frozen=True, eq=False)
class Slopes:
    """Distances (N,) of points, and what the products with their derivatives need.

    Args:
        values: (N,) float64.
        points: (N,3) float32 in the unit sphere's box.
        by_seen: (N,E) by each part of what the points see of the code.
        similar: (N,7) by log size, rotation and translation.
        outward: (N,3) float64 unit gradients in the world.
        decoder: Of the network.
    """

    values: Tensor
    points: Tensor
    by_seen: tuple[Tensor, ...]
    similar: Tensor
    outward: Tensor
    decoder: Decoder

    @cached_property
    def jacobian(self) -> CodeJacobian:
        """Derivatives by the code."""
        return CodeJacobian(self.decoder, self.by_seen, self.points)


class CodeUnknowns:
    """The unknowns of a fit of a whole code, their prior, and how distances depend on them.

    Args:
        backend: The network.
        start: Where fits begin and what their pose and size are believed to be near: theta is the size and components.
        deviations: (7,) of log size, rotation [rad] and translation about the start.
    """

    def __init__(self, backend: DeepSDFBackend, start: State, deviations: Tensor) -> None:
        self.backend, model = backend, backend.model
        # Many shapes leave little open of codes of few numbers.
        share = OPEN * min(1.0, model.code_size / len(model.codes))
        self.gaussian = CodeGaussian(model.codes, model.settings.code_deviation**2, share)
        self.deviations = deviations.to(model.device, torch.float64)
        away = backend.code(start.theta) - self.gaussian.mean
        self._bound = model.settings.code_bound
        self.start = WholeCode(self.gaussian.standard(away).double(), replace(start, theta=start.theta[:1]))

    def code(self, at: WholeCode) -> Tensor:
        """The code (D,) float32."""
        return self.gaussian.mean + self.gaussian.spread(at.standard.float())

    def radius(self, at: WholeCode) -> float:
        """Radius of the sphere around the shape."""
        return self.backend.factor * float(at.state.theta[0])

    def moved(self, at: WholeCode, step: Tensor) -> WholeCode:
        """After an increment (D+7,) of the unknowns."""
        similar = step[-7:] * self.deviations
        state = at.state.moved(torch.cat([at.state.theta * similar[:1].expm1(), similar[1:]]))
        return WholeCode(at.standard + step[:-7], state)

    def away(self, at: WholeCode) -> Tensor:
        """(D+7,) the unknowns; half their squared length is the prior's penalty."""
        start = self.start.state
        size = (at.state.theta / start.theta).log()
        turn = vector_from_rotation(start.rotation.T @ at.state.rotation)
        similar = torch.cat([size, turn, at.state.translation - start.translation]) / self.deviations
        return torch.cat([at.standard, similar])

    def distances(self, at: WholeCode, inside: Tensor) -> Tensor:
        """Signed distances (N,) float64 of points (N,3) of the shape's own frame."""
        radius = self.radius(at)
        with torch.no_grad(), threads(self.backend.threads):
            return radius * self.backend.model.signed_distance((inside / radius).float(), self.code(at)).double()

    def slopes(self, at: WholeCode, points: Tensor) -> Slopes:
        """Of points (N,3) in the world."""
        inside, radius, code = at.state.to_shape(points), self.radius(at), self.code(at)
        unit = inside / radius
        with threads(self.backend.threads):
            parts = [self.backend.model.slopes(part, code) for part in unit.float().split(POINTS)]
        values = radius * torch.cat([part.values for part in parts]).double()
        by_point = torch.cat([part.by_point for part in parts]).double()
        by_seen = tuple(radius * torch.cat(each) for each in zip(*(part.by_seen for part in parts), strict=True))
        # d(r f(x / r)) / d log r = r f - x . grad f.
        by_size = values - (inside * by_point).sum(1)
        similar = at.state.chain(inside, by_size[:, None], by_point) * self.deviations
        outward = normalize(by_point @ at.state.rotation.T, dim=1)
        decoder = self.backend.model.decoder
        return Slopes(values, unit.float().clamp(-1, 1), by_seen, similar, outward, decoder)

    def rows(self, slopes: Slopes, at: WholeCode) -> Tensor:
        """Derivatives (N,D) float32 by the code itself: what `forward` multiplies, for few points."""
        found = self.backend.model.decoder.rows(slopes.by_seen, slopes.points)
        return directions(found, self.code(at), self._bound)

    def forward(self, slopes: Slopes, at: WholeCode, step: Tensor) -> Tensor:
        """Changes (N,) float64 of the distances with a step (D+7,)."""
        with threads(self.backend.threads):
            along = directions(self.gaussian.spread(step[:-7].float())[None], self.code(at), self._bound)
            by_code = slopes.jacobian.forward(along[0])
        return by_code + slopes.similar @ step[-7:]

    def backward(self, slopes: Slopes, at: WholeCode, pull: Tensor) -> Tensor:
        """The transpose of `forward`: (N,) to (D+7,)."""
        with threads(self.backend.threads):
            by_code = slopes.jacobian.backward(pull.float())[None]
            # The projection onto the bounded codes' sphere is symmetric.
            by_code = self.gaussian.spread(directions(by_code, self.code(at), self._bound)[0])
        return torch.cat([by_code.double(), slopes.similar.T @ pull])


class Evenness:
    """The slopes of distances along their gradients at some points, which are 1 but for a deviation `SLOPE`.

    Args:
        unknowns: The unknowns.
        at: Where.
        points: (M,3) in the world, near the surface.
        outward: (M,3) unit gradients there.
    """

    def __init__(self, unknowns: CodeUnknowns, at: WholeCode, points: Tensor, outward: Tensor) -> None:
        self.unknowns, self.at, self.way = unknowns, at, WAY * unknowns.radius(at)
        self.ends = tuple(unknowns.slopes(at, points + s * self.way * outward) for s in (1, -1))
        self.residual = (self.ends[0].values - self.ends[1].values) / (2 * self.way) - 1

    @property
    def penalty(self) -> float:
        """Minus the log density, but for a constant."""
        return 0.5 * float(self.residual.square().sum()) / SLOPE**2

    @cached_property
    def rows(self) -> tuple[Tensor, Tensor]:
        """Derivatives (M,D) float32 by the code and (M,7) by the others."""
        one, other = (self.unknowns.rows(end, self.at) for end in self.ends)
        return (one - other) / (2 * self.way), (self.ends[0].similar - self.ends[1].similar) / (2 * self.way)

    def forward(self, step: Tensor) -> Tensor:
        """Changes (M,) with a step (D+7,)."""
        by_code, similar = self.rows
        return (by_code @ self.unknowns.gaussian.spread(step[:-7].float())).double() + similar @ step[-7:]

    def backward(self, pull: Tensor) -> Tensor:
        """The transpose of `forward`."""
        by_code, similar = self.rows
        along = self.unknowns.gaussian.spread(by_code.T @ pull.float())
        return torch.cat([along.double(), similar.T @ pull])


def prior_deviations(backend: DeepSDFBackend) -> Tensor:
    """(7,) of log size, rotation [rad] and translation, which the components' fit has found."""
    radii = sorted(sphere.radius for sphere in backend.model.spheres)
    shift = HELD_SIZE * backend.factor * radii[len(radii) // 2]
    return torch.tensor([HELD_SIZE, *[HELD_TURN] * 3, *[shift] * 3], dtype=torch.float64)
