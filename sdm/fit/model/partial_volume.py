"""Partial volume: the share of a shape's inside in each of a scanner's voxels, blurred, with derivatives.

The probability of inside at a point is logistic(-SDM / length), as in Wang et al., Medical Image Analysis 2022. A voxel
is an average of such points, weighted by the scanner's point spread function and the voxel's box. With one point for
each voxel and no blur it is their model itself.
"""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.fit.model.backend import Backend
from sdm.fit.model.pose import State

# Further from the surface than this many reference lengths, the logistic is 0 or 1 to 4e-4.
REACH = 8.0
# Slack, as a share of the reach, from which on it brings in many points that are not near.
SLACK = 0.25
# Edges, in sample points, of the boxes with which the search for the surface's band goes on to points.
LEVELS = (8, 4, 2, 1)
# Variance of the logistic distribution with scale 1.
LOGISTIC_VARIANCE = math.pi**2 / 3


@dataclass(frozen=True, eq=False)
class Rendered:
    """The share of inside of each voxel: `share` (nx,ny,nz) float64, `by_step` (P+6,nx,ny,nz) float32 or None."""

    share: Tensor
    by_step: Tensor | None


@dataclass(frozen=True, eq=False)
class Samples:
    """Shares of inside at all sample points, before any blur: another one costs no further distances.

    Args:
        share: (mx,my,mz) float64.
        by_step: (P+6,bx,by,bz) float32 its derivatives by the increments of `State.moved` in the box of sample points
            outside which they are 0, or None.
        corner: The first sample point of that box along each axis.
    """

    share: Tensor
    by_step: Tensor | None
    corner: tuple[int, int, int] = (0, 0, 0)


class Renderer:
    """Renders shapes on one grid.

    Args:
        grid: The image's grid.
        backend: Where distances come from.
        blur: Standard deviation of the Gaussian point spread function [mm].
        length: The reference length l_ref of the logistic [mm].
        fine: Largest distance between sample points [mm]; with several points to a voxel, partial volume is exact to
            second order in it.
        times: So many times as many sample points along each axis as `fine` asks for.
    """

    def __init__(
        self, grid: Grid, backend: Backend, *, blur: float, length: float, fine: float, times: int = 1
    ) -> None:
        self.grid, self.backend, self.length = grid, backend, length
        device = backend.device
        self.parts = [times * max(1, math.ceil(s / fine - 1e-9)) for s in grid.spacing]
        pads = [math.ceil(3 * self._rest(blur) / s) for s in grid.spacing]
        wanted = [(n + 2 * p) * m for n, p, m in zip(grid.shape, pads, self.parts, strict=True)]
        self.count = [math.ceil(n / LEVELS[0]) * LEVELS[0] for n in wanted]
        self.first = [0.5 / n - 0.5 - p for n, p in zip(self.parts, pads, strict=True)]
        self._steps = torch.tensor([s / n for s, n in zip(grid.spacing, self.parts, strict=True)], device=device)
        self._steps = self._steps.double()
        axes = torch.tensor(grid.direction, dtype=torch.float64, device=device)
        start = torch.tensor([f * s for f, s in zip(self.first, grid.spacing, strict=True)], dtype=torch.float64)
        self._axes = axes * self._steps
        self._origin = torch.tensor(grid.origin, dtype=torch.float64, device=device) + axes @ start.to(device)
        self._weights = self._weights_of(blur)

    def with_blur(self, blur: float) -> Renderer:
        """The same sample points under a blur that differs by little: what lies further out is as it was."""
        other = copy.copy(self)
        other._weights = other._weights_of(blur)
        return other

    def _rest(self, blur: float) -> float:
        # The logistic blurs a little by itself: the point spread function does the rest.
        return math.sqrt(max(0.0, blur**2 - LOGISTIC_VARIANCE * self.length**2))

    def _weights_of(self, blur: float) -> list[Tensor]:
        grid, rest = self.grid, self._rest(blur)
        return [
            _weights(grid.shape[a], self.count[a], self.parts[a], self.first[a], rest / grid.spacing[a]).to(
                self.backend.device
            )
            for a in range(3)
        ]

    def __call__(self, state: State, *, derivatives: bool = True) -> Rendered:
        """The share of inside in each voxel, and how it changes with the increments of `State.moved`."""
        return self.rendered(self.sampled(state, derivatives=derivatives))

    def rendered(self, samples: Samples) -> Rendered:
        """Voxels of sample points."""
        by_step = None if samples.by_step is None else self.blurred(samples.by_step, samples.corner)
        return Rendered(self.blurred(samples.share), by_step)

    def sampled(self, state: State, *, derivatives: bool = True) -> Samples:
        """The share of inside at each sample point; only those near the surface are looked up one by one."""
        return self._looked_up(state, *self.near_surface(state), derivatives)

    def near_surface(self, state: State) -> tuple[Tensor, Tensor]:
        """Indices (N,3) of sample points near the surface, and the mask (mx,my,mz) of inside of all others."""
        theta, reach, device = state.theta, REACH * self.length, self.backend.device
        boxes = [n // LEVELS[0] for n in self.count]
        near = torch.cartesian_prod(*[torch.arange(n, device=device) for n in boxes])
        inside = torch.zeros(boxes, dtype=torch.bool, device=device)
        for edge, finer in itertools.pairwise(LEVELS):
            distance = self.backend.distances(theta, state.to_shape(self.points_of(near, edge)))
            inside[tuple(near.T)] = distance < 0
            # From the middle to the furthest of its points, not to the box's corner.
            half = float(self._steps.norm()) * (edge - 1) / 2
            near = near[distance.abs() < half + reach + self.backend.slack]
            times = edge // finer
            within = torch.cartesian_prod(*[torch.arange(times, device=device)] * 3)
            near = (near[:, None] * times + within).reshape(-1, 3)
            for axis in range(3):
                inside = inside.repeat_interleave(times, dim=axis)
        if self.backend.slack > SLACK * reach:
            # Of learned distances those of the points themselves say which are near, for less than derivatives cost.
            distance = self.backend.distances(theta, state.to_shape(self.points_of(near)))
            inside[tuple(near.T)] = distance < 0
            near = near[distance.abs() < reach]
        return near, inside

    def _looked_up(self, state: State, near: Tensor, inside: Tensor, derivatives: bool) -> Samples:
        share = inside.double()
        at = state.to_shape(self.points_of(near))
        if not derivatives:
            share[tuple(near.T)] = torch.sigmoid(self.backend.distances(state.theta, at) / -self.length)
            return Samples(share, None)
        found = self.backend.with_derivatives(state.theta, at)
        p = torch.sigmoid(found.values / -self.length)
        share[tuple(near.T)] = p
        slope = p * (1 - p) / self.length
        by_step = state.chain(at, found.by_theta, found.by_point) * -slope[:, None]
        x, y, z = near.amin(0).tolist() if len(near) else (0, 0, 0)
        box = (near.amax(0) + 1).tolist() if len(near) else (0, 0, 0)
        # Derivatives of 1e-7 relative accuracy are plenty, at half the memory.
        dense = torch.zeros(by_step.shape[1], box[0] - x, box[1] - y, box[2] - z, device=share.device)
        dense[:, near[:, 0] - x, near[:, 1] - y, near[:, 2] - z] = by_step.T.float()
        return Samples(share, dense, (x, y, z))

    def points_of(self, index: Tensor, edge: int = 1) -> Tensor:
        """Middles (N,3) of boxes of sample points."""
        return (index.double() * edge + (edge - 1) / 2) @ self._axes.T + self._origin

    def blurred(self, values: Tensor, corner: tuple[int, int, int] = (0, 0, 0)) -> Tensor:
        """Values (...,mx,my,mz) at sample points, averaged to those of voxels (...,nx,ny,nz).

        Of values in a box of sample points from `corner` on, all others are 0.
        """
        x, y, z = (
            w[:, first : first + count].to(values.dtype)
            for w, first, count in zip(self._weights, corner, values.shape[-3:], strict=True)
        )
        values = y @ (values @ z.T)
        return (x @ values.flatten(-2)).unflatten(-1, (y.shape[0], z.shape[0]))

    def spread(self, values: Tensor) -> Tensor:
        """The transpose of `blurred`: voxels (nx,ny,nz) to sample points (mx,my,mz)."""
        x, y, z = (w.to(values.dtype) for w in self._weights)
        values = y.T @ (values @ z)
        return (x.T @ values.flatten(-2)).unflatten(-1, (y.shape[1], z.shape[1]))


def _weights(voxels: int, samples: int, parts: int, first: float, blur: float) -> Tensor:
    """Weights (voxels, samples) of sample points in voxels along an axis: a box convolved with a Gaussian, sums 1."""
    at = first + torch.arange(samples, dtype=torch.float64) / parts
    away = at - torch.arange(voxels, dtype=torch.float64)[:, None]
    if blur == 0:
        weights = (away.abs() < 0.5).double()
    else:
        weights = torch.special.ndtr((away + 0.5) / blur) - torch.special.ndtr((away - 0.5) / blur)
    return weights / weights.sum(1, keepdim=True)
