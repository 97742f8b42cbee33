"""Smooth displacements that carry one shape onto another, found by their signed distance maps.

Thirion's demons (Medical Image Analysis 1998) on distance maps in place of images: every voxel near either surface is
pushed along the moving map's gradient by as much as the two distances differ, and the displacement is smoothed after
each step. Where neither surface is near, it fades.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from sdm.runtime.torch_warp import to_device

# Distances beyond so many voxels pull no more than these.
REACH = 8.0
STEPS = 60
# Longest push of a step, in voxels, and standard deviations of the Gaussians over the pushes and over their sum.
LONGEST, FLUID, ELASTIC = 0.75, 2.0, 0.7
# A displacement is shortened until volumes shrink to no less than this share of what they were.
LEAST_VOLUME = 0.2
SHARES = (1.0, 0.85, 0.7, 0.55, 0.4, 0.25, 0.1)
# Fixed-point steps by which a displacement is inverted at points.
INVERSIONS = 16


def displacement(moving: Tensor, fixed: Tensor, *, steps: int = STEPS) -> Tensor:
    """The displacement u (3,x,y,z) in voxels by which `moving` at x + u(x) is like `fixed` at x.

    Args:
        moving: (x,y,z) signed distances in voxels, negative inside.
        fixed: The same of the shape to come near to.
        steps: Of the demons.

    It does not fold: where it would, all of it is shortened, and then `moving` gets less far. Waits for no device.
    """
    goal, still = fixed.clamp(-REACH, REACH), moving.clamp(-REACH, REACH)
    seen = torch.cat([still[None], _gradient(still)])
    u = torch.zeros((3, *moving.shape), dtype=moving.dtype, device=moving.device)
    fluid, elastic = ([_smoothing(n, width, u) for n in moving.shape] for width in (FLUID, ELASTIC))
    for _ in range(steps):
        now = warped(seen, u)
        rest, slope = now[0] - goal, now[1:]
        # |push| = |rest| |slope| / (slope^2 + (rest / 2 LONGEST)^2) is never longer than LONGEST.
        push = -rest * slope / (slope.square().sum(0) + (rest / (2 * LONGEST)).square()).clamp_min(1e-6)
        u = _smooth(u + _smooth(push, fluid), elastic)
    return u * unfolded_share(u)


def unfolded_share(u: Tensor) -> Tensor:
    """The largest of some shares of a displacement (3,x,y,z) that leaves volumes positive; a scalar on its device."""
    least = torch.stack([volumes(share * u).amin() for share in SHARES])
    shares = to_device(torch.tensor(SHARES, device="cpu"), u.device)
    return (shares * (least > LEAST_VOLUME)).amax()


def volumes(u: Tensor) -> Tensor:
    """The volume (x,y,z) to which x + u(x) stretches each voxel, as a share of what it was: its Jacobian."""
    rows = torch.stack([_gradient(axis) for axis in u])
    a, b, c = (rows[:, k] for k in range(3))
    a, b, c = (v + _unit_vector(k, v) for k, v in enumerate((a, b, c)))
    return (a * torch.linalg.cross(b, c, dim=0)).sum(0)


def warped(values: Tensor, u: Tensor) -> Tensor:
    """Values (C,x,y,z) at x + u(x), linearly; beyond the border those at it."""
    shape = values.shape[1:]
    places = _own_places(shape, u) + u
    return functional.grid_sample(
        values[None], _normal(places, shape)[None], padding_mode="border", align_corners=True
    )[0]


def moved(points: Tensor, u: Tensor) -> Tensor:
    """Places x (N,3) of points y of the unwarped volume after it is warped: x + u(x) = y, in voxels."""
    shape, x = u.shape[1:], points
    for _ in range(INVERSIONS):
        at = _normal(x.T.reshape(3, -1, 1, 1), shape)[None]
        step = functional.grid_sample(u[None], at, padding_mode="border", align_corners=True)
        x = points - step.reshape(3, -1).T
    return x


def enlarged(u: Tensor, factor: int, shape: tuple[int, ...]) -> Tensor:
    """A displacement found on voxels `factor` times as large, for all voxels of a volume, in these."""
    if factor == 1:
        return u
    fine = functional.interpolate(u[None], scale_factor=factor, mode="trilinear", align_corners=False)[0] * factor
    x, y, z = shape
    return fine[:, :x, :y, :z]


def _own_places(shape: torch.Size, like: Tensor) -> Tensor:
    """(3,x,y,z): each voxel's own index."""
    lines = [torch.arange(n, dtype=like.dtype, device=like.device) for n in shape]
    return torch.stack(torch.meshgrid(*lines, indexing="ij"))


def _normal(places: Tensor, shape: torch.Size) -> Tensor:
    """Places (3,...) in voxels as `grid_sample` wants them: (...,3) in -1..1, the last axis first."""
    parts = [2 * place / max(1, n - 1) - 1 for place, n in zip(places, shape, strict=True)]
    return torch.stack(parts[::-1], -1)


def _gradient(values: Tensor) -> Tensor:
    """(3,x,y,z) by central differences, one-sided at the border."""
    return torch.stack(torch.gradient(values))


def _smoothing(count: int, deviation: float, like: Tensor) -> Tensor:
    """Matrix (count,count) of a Gaussian along a line, which goes on beyond its ends as at them."""
    place = torch.arange(count, dtype=like.dtype, device=like.device)
    room = int(3 * deviation + 0.5)
    matrix = torch.zeros((count, count), dtype=like.dtype, device=like.device)
    total = 0.0
    for offset in range(-room, room + 1):
        weight = math.exp(-0.5 * (offset / deviation) ** 2)
        near = (place + offset).clamp(0, count - 1).long()
        matrix.scatter_add_(1, near[:, None], torch.full_like(place, weight)[:, None])
        total += weight
    return matrix / total


def _smooth(values: Tensor, lines: Sequence[Tensor]) -> Tensor:
    """(3,x,y,z), along each axis by its matrix."""
    x, y, z = lines
    values = torch.matmul(y, values @ z.T)
    return torch.matmul(x, values.flatten(2)).reshape(values.shape)


def _unit_vector(axis: int, like: Tensor) -> Tensor:
    """(3,1,1,1): 1 along an axis."""
    one = torch.zeros((3, 1, 1, 1), dtype=like.dtype, device=like.device)
    one[axis] = 1
    return one
