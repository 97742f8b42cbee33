"""Fit of a DeepSDF's whole code, size and pose to an image, from a fit of its components on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf.infer.code_steps import (
    SLOPE,
    CodeUnknowns,
    Evenness,
    Slopes,
    WholeCode,
    prior_deviations,
)
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend
from sdm.deepsdf.infer.isosurface import decode_mesh
from sdm.deepsdf.infer.preconditioner import Preconditioner
from sdm.deepsdf.samples import UnitSphere
from sdm.fit.model.backend import Distances
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.solve.fit_shape import FitOptions, image_tensor, renderer_of
from sdm.runtime.threads import threads
from sdm.training.conjugate_gradients import conjugate_gradients

# Where the start explains less than this of its neighbourhood, first lengths of the logistic [voxels] under which a
# surface is felt that lies some voxels off; steps at each, and at the last.
FAR, LENGTHS, STEPS, LAST = 0.97, (1.2, 0.5), 2, 15
# The last steps end where the expected image changes by less than so many deviations of the noise, root mean square
# over the voxels that the surface cuts; a search that ends with more than the second has not converged. Less noise than
# this share of the contrast counts as so much: a surface does not go a hundredth of a voxel for a change of that.
CHANGED, UNSETTLED, LITTLE = 0.1, 0.35, 0.05
# A step that does not go down is halved so often.
HALVED = 3
# Steps of conjugate gradients at most, and the share of the residual, in the given inverse's norm, at which they end.
SOLVES, ACCURACY = 250, 1e-3
# Voxels with less of the other side than this are not cut. So many tell their noise.
PURE, MANY = 0.01, 100
# Points at which the slope of the distances is looked at.
EVEN = 2000


@dataclass(frozen=True, eq=False)
class CodeFit:
    """A whole code in an image.

    Args:
        code: (D,) float32.
        state: Pose, with theta (1,) the size.
        share: (nx,ny,nz) expected share of inside of each voxel.
        noise: Standard deviation of what is left, in intensities, where the surface cuts voxels or elsewhere, whichever
            is larger.
        inside: Intensity inside.
        outside: Intensity outside.
        converged: The last step changed the objective by little.
        steps: That were taken.
    """

    code: Tensor
    state: State
    share: Tensor
    noise: float
    inside: float
    outside: float
    converged: bool
    steps: int

    def record(self) -> dict[str, Any]:
        """Plain numbers, for JSON."""
        rotation, translation = self.state.rotation.tolist(), self.state.translation.tolist()
        return {
            "numbers": len(self.code),
            "size": float(self.state.theta[0]),
            "rotation": rotation,
            "translation": translation,
            "noise": self.noise,
            "inside": self.inside,
            "outside": self.outside,
            "converged": self.converged,
            "steps": self.steps,
        }

    def mesh(self, backend: DeepSDFBackend, resolution: int = 192) -> TriangleMesh:
        """The surface in the image's frame."""
        return surface_of_code(backend, self.code, self.state, resolution)


def surface_of_code(backend: DeepSDFBackend, code: Tensor, state: State, resolution: int = 192) -> TriangleMesh:
    """The surface of a code in a pose, theta (1,) its size, by marching cubes."""
    sphere = UnitSphere((0.0, 0.0, 0.0), backend.factor * float(state.theta[0]))
    own = decode_mesh(backend.model, code, sphere=sphere, resolution=resolution)
    vertices = state.to_world(own.vertices.to(state.translation)).float()
    return TriangleMesh(vertices.cpu(), own.faces.cpu(), "fit", check=False)


def fit_code(
    image: Tensor,
    grid: GridLike,
    backend: DeepSDFBackend,
    start: State,
    *,
    options: FitOptions,
    explained: float = 0.0,
    report: Callable[[str, int], None] | None = None,
) -> CodeFit:
    """Fit all numbers of a code, and size and pose again, to an image.

    Args:
        image: (nx,ny,nz) intensities: one inside and one outside, mixed in the voxels that the surface cuts, and noise.
        grid: Where its voxels are.
        backend: The network.
        start: A state of the backend, as a fit of its components leaves it.
        options: Of that fit: blur and sample points.
        explained: Share of its neighbourhood that the start explains.
        report: Called with the stage and the number of each step.

    The maximum of the posterior density under the Gaussian of the training's codes.
    """
    grid = as_grid(grid)
    values = image_tensor(image, grid, backend.device)
    unknowns = CodeUnknowns(backend, start, prior_deviations(backend))
    at, found, steps, converged = unknowns.start, None, 0, False
    last = renderer_of(grid, _Frozen(unknowns, at), options)
    wide = [length * min(grid.spacing) for length in LENGTHS] if explained < FAR else []
    for length in [*(x for x in wide if x > last.length), last.length]:
        final = length == last.length
        renderer = last if final else renderer_of(grid, last.backend, replace(options, length=length))
        looks = _Image(values, renderer, unknowns)
        found = looks(at)
        for _ in range(LAST if final else STEPS):
            following, there, changed = looks.step(at, found)
            if report is not None:
                report("code", steps)
            converged = final and changed < UNSETTLED
            if following is at:
                break
            at, found, steps = following, there, steps + 1
            if final and changed < CHANGED:
                break
    assert found is not None  # noqa: S101 - there is a last length
    return CodeFit(unknowns.code(at), at.state, found.voxels, found.noise, found.high, found.low, converged, steps)


class _Frozen:
    """A whole code as a backend without parameters, for a renderer's search for the surface."""

    name, parameters, evaluations = "code", (), 0

    def __init__(self, unknowns: CodeUnknowns, at: WholeCode) -> None:
        self.unknowns, self.at = unknowns, at
        self.device, self.centre, self.slack = unknowns.backend.device, at.state.centre, unknowns.backend.slack

    def distances(self, theta: Tensor, points: Tensor) -> Tensor:
        """Signed distances (N,) of points (N,3) of the shape's own frame."""
        return self.unknowns.distances(self.at, points)

    def with_derivatives(self, theta: Tensor, points: Tensor) -> Distances:
        """There are no parameters to differentiate by."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class _Rendered:
    """An image of a code: expected shares, what is left, and derivatives."""

    slopes: Slopes
    even: Evenness
    place: tuple[Tensor, ...]
    felt: Tensor
    voxels: Tensor
    residual: Tensor
    noise: float
    low: float
    high: float


class _Image:
    """An image under one length of the logistic."""

    def __init__(self, values: Tensor, renderer: Renderer, unknowns: CodeUnknowns) -> None:
        self.values, self.renderer, self.unknowns = values, renderer, unknowns

    def __call__(self, at: WholeCode) -> _Rendered:
        """The expected image of a code."""
        renderer, backend = self.renderer, self.renderer.backend
        backend.at = at  # type: ignore[attr-defined]
        near, inside = renderer.near_surface(at.state)
        points = renderer.points_of(near)
        slopes = self.unknowns.slopes(at, points)
        some = torch.linspace(0, len(points) - 1, EVEN, device=points.device).long() if len(points) else near[:0, 0]
        even = Evenness(self.unknowns, at, points[some], slopes.outward[some])
        share, place = inside.double(), tuple(near.T)
        share[place] = p = torch.sigmoid(-slopes.values / renderer.length)
        voxels = renderer.blurred(share)
        design = torch.stack([1 - voxels.flatten(), voxels.flatten()], 1)
        low, high = torch.linalg.solve(design.T @ design, design.T @ self.values.flatten()).tolist()
        residual = self.values - (low + (high - low) * voxels)
        # As long as the shape is wrong, the voxels that it cuts say so, and steps stay near what the prior knows.
        cut = (voxels > PURE) & (voxels < 1 - PURE)
        noise = max(_deviation(residual[cut]), _deviation(residual[~cut]), 1e-3 * abs(high - low))
        felt = -(high - low) * p * (1 - p) / renderer.length
        return _Rendered(slopes, even, place, felt, voxels, residual, noise, low, high)

    def changed(self, found: _Rendered, following: _Rendered) -> float:
        """Change of the expected image from one code to the next; see `CHANGED`."""
        cut = (following.voxels > 0.05) & (following.voxels < 0.95)
        if not bool(cut.any()):
            return 0.0
        contrast = abs(following.high - following.low)
        by = contrast * float((following.voxels - found.voxels)[cut].square().mean().sqrt())
        return by / max(following.noise, LITTLE * contrast)

    def objective(self, at: WholeCode, found: _Rendered, noise: float) -> float:
        """Minus the log posterior density, but for a constant, under a given noise."""
        away = 0.5 * float(self.unknowns.away(at).square().sum())
        return 0.5 * float(found.residual.square().sum()) / noise**2 + found.even.penalty + away

    def step(self, at: WholeCode, found: _Rendered) -> tuple[WholeCode, _Rendered, float]:
        """The next code, its image, and how much the image changed; the same code where steps no longer go down."""
        unknowns, renderer, weight = self.unknowns, self.renderer, 1 / found.noise**2
        shape = tuple(renderer.count)

        def forward(step: Tensor) -> Tensor:
            dense = torch.zeros(shape, dtype=torch.float64, device=step.device)
            dense[found.place] = found.felt * unknowns.forward(found.slopes, at, step)
            return renderer.blurred(dense)

        def backward(image: Tensor) -> Tensor:
            return unknowns.backward(found.slopes, at, found.felt * renderer.spread(image)[found.place])

        def normal(step: Tensor) -> Tensor:
            return weight * backward(forward(step)) + even.backward(even.forward(step)) / SLOPE**2 + step

        even = found.even
        right = weight * backward(found.residual) - even.backward(even.residual) / SLOPE**2 - unknowns.away(at)
        inverse = self._preconditioner(at, found, right, forward(right))
        step = conjugate_gradients(normal, right, SOLVES, preconditioner=inverse, accuracy=ACCURACY)
        before, most = self.objective(at, found, found.noise), 0.0
        for _ in range(HALVED):
            moved = unknowns.moved(at, step)
            there = self(moved)
            changed = self.changed(found, there)
            if self.objective(moved, there, found.noise) < before:
                return moved, there, changed
            step, most = step / 2, max(most, changed)
        return at, found, most

    def _preconditioner(self, at: WholeCode, found: _Rendered, step: Tensor, image: Tensor) -> Preconditioner:
        """Of a step's matrix; a step and its image say how much of changes at sample points is left in an image."""
        unknowns, slopes = self.unknowns, found.slopes
        left = image.square().sum() / (found.felt * unknowns.forward(slopes, at, step)).square().sum()
        by_code, similar = found.even.rows
        importance = left / found.noise**2 * found.felt.square()
        even = by_code / SLOPE, similar / SLOPE
        with threads(unknowns.backend.threads):
            return Preconditioner(unknowns.gaussian, slopes.jacobian, slopes.similar, importance, even)


def _deviation(residual: Tensor) -> float:
    """Root mean square of residuals; 0 of few."""
    return float(residual.square().mean().sqrt()) if len(residual) > MANY else 0.0
