"""Partial volume: the share of a shape's inside in each of a scanner's voxels, blurred, with derivatives.

The probability of inside at a point is logistic(-SDM / length), as in Wang et al., Medical Image Analysis 2022. A voxel
is an average of such points, weighted by the scanner's point spread function and the voxel's box. With one point for
each voxel and no blur it is their model itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.fit.model.backend import Backend
from sdm.fit.model.pose import State

# Further from the surface than this many reference lengths, the logistic is 0 or 1 to 4e-4.
REACH = 8.0
# Voxels along the edge of the blocks with which the search for the surface's band begins.
BLOCK = 4
# Variance of the logistic distribution with scale 1.
LOGISTIC_VARIANCE = math.pi**2 / 3


@dataclass(frozen=True, eq=False)
class Rendered:
    """The share of inside of each voxel: `share` (nx,ny,nz) float64, `by_step` (P+6,nx,ny,nz) float32 or None."""

    share: Tensor
    by_step: Tensor | None


class Renderer:
    """Renders shapes on one grid.

    Args:
        grid: The image's grid.
        backend: Where distances come from.
        blur: Standard deviation of the Gaussian point spread function [mm].
        length: The reference length l_ref of the logistic [mm].
        fine: Largest distance between sample points [mm]; with several points to a voxel, partial volume is exact to
            second order in it.
    """

    def __init__(self, grid: Grid, backend: Backend, *, blur: float, length: float, fine: float) -> None:
        self.grid, self.backend, self.length = grid, backend, length
        self.parts = [max(1, math.ceil(s / fine - 1e-9)) for s in grid.spacing]
        # The logistic blurs a little by itself: the point spread function does the rest.
        rest = math.sqrt(max(0.0, blur**2 - LOGISTIC_VARIANCE * length**2))
        pads = [math.ceil(3 * rest / s) for s in grid.spacing]
        blocks = [math.ceil((n + 2 * p) / BLOCK) for n, p in zip(grid.shape, pads, strict=True)]
        self.count = [b * BLOCK * n for b, n in zip(blocks, self.parts, strict=True)]
        self.first = [0.5 / n - 0.5 - p for n, p in zip(self.parts, pads, strict=True)]
        device = backend.device
        self._steps = torch.tensor([s / n for s, n in zip(grid.spacing, self.parts, strict=True)], device=device)
        self._steps = self._steps.double()
        axes = torch.tensor(grid.direction, dtype=torch.float64, device=device)
        start = torch.tensor([f * s for f, s in zip(self.first, grid.spacing, strict=True)], dtype=torch.float64)
        self._axes = axes * self._steps
        self._origin = torch.tensor(grid.origin, dtype=torch.float64, device=device) + axes @ start.to(device)
        self._weights = [
            _weights(grid.shape[a], self.count[a], self.parts[a], self.first[a], rest / grid.spacing[a]).to(device)
            for a in range(3)
        ]
        # Blocks, voxels, sample points: each level's edge in sample points.
        self._levels = [[BLOCK * n for n in self.parts], self.parts, [1, 1, 1]]
        if max(self.parts) == 1:
            del self._levels[1]

    @property
    def samples(self) -> int:
        """Sample points in all; only those near the surface are looked up one by one."""
        return math.prod(self.count)

    def __call__(self, state: State, *, derivatives: bool = True) -> Rendered:
        """The share of inside in each voxel, and how it changes with the increments of `State.moved`."""
        theta, reach = state.theta, REACH * self.length
        device = self.backend.device
        edge = self._levels[0]
        near = torch.cartesian_prod(
            *[torch.arange(n // e, device=device) for n, e in zip(self.count, edge, strict=True)]
        )
        inside = torch.zeros([n // e for n, e in zip(self.count, edge, strict=True)], dtype=torch.bool, device=device)
        for edge, finer in zip(self._levels, self._levels[1:], strict=False):
            at = state.to_shape(self._points(near, edge))
            distance = self.backend.distances(theta, at)
            inside[tuple(near.T)] = distance < 0
            half = float((self._steps * torch.tensor(edge, device=device)).norm()) / 2
            near = near[distance.abs() < half + reach + self.backend.slack]
            split = [e // f for e, f in zip(edge, finer, strict=True)]
            inside = _repeat(inside, split)
            within = torch.cartesian_prod(*[torch.arange(s, device=device) for s in split])
            near = (near[:, None] * torch.tensor(split, device=device) + within).reshape(-1, 3)
        return self._average(state, near, inside, derivatives)

    def _average(self, state: State, near: Tensor, inside: Tensor, derivatives: bool) -> Rendered:
        share = inside.double()
        at = state.to_shape(self._points(near, [1, 1, 1]))
        if not derivatives:
            share[tuple(near.T)] = torch.sigmoid(self.backend.distances(state.theta, at) / -self.length)
            return Rendered(self._blurred(share), None)
        found = self.backend.with_derivatives(state.theta, at)
        p = torch.sigmoid(found.values / -self.length)
        share[tuple(near.T)] = p
        by_step = state.chain(at, found.by_theta, found.by_point) * (p * (p - 1) / self.length)[:, None]
        # Derivatives of 1e-7 relative accuracy are plenty, at half the memory.
        dense = torch.zeros(by_step.shape[1], *share.shape, device=share.device)
        dense[(slice(None), *near.T)] = by_step.T.float()
        return Rendered(self._blurred(share), self._blurred(dense))

    def _points(self, index: Tensor, edge: list[int]) -> Tensor:
        size = torch.tensor(edge, dtype=torch.float64, device=index.device)
        return (index * size + (size - 1) / 2) @ self._axes.T + self._origin

    def _blurred(self, values: Tensor) -> Tensor:
        x, y, z = (w.to(values.dtype) for w in self._weights)
        values = y @ (values @ z.T)
        return (x @ values.flatten(-2)).unflatten(-1, (y.shape[0], z.shape[0]))


def _weights(voxels: int, samples: int, parts: int, first: float, blur: float) -> Tensor:
    """Weights (voxels, samples) of sample points in voxels along an axis: a box convolved with a Gaussian, sums 1."""
    at = first + torch.arange(samples, dtype=torch.float64) / parts
    away = at - torch.arange(voxels, dtype=torch.float64)[:, None]
    if blur == 0:
        weights = (away.abs() < 0.5).double()
    else:
        weights = torch.special.ndtr((away + 0.5) / blur) - torch.special.ndtr((away - 0.5) / blur)
    return weights / weights.sum(1, keepdim=True)


def _repeat(values: Tensor, times: list[int]) -> Tensor:
    for axis, n in enumerate(times):
        values = values.repeat_interleave(n, dim=axis)
    return values
