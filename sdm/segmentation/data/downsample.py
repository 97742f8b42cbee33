"""Volumes of larger voxels, so that a network sees all of them at once, and the way back.

A coarse voxel is a cube of `factor`^3 fine ones. Where a volume is no multiple of that, its last voxels are repeated.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor
from torch.nn import functional


def whole_cubes(values: Tensor, factor: int) -> Tensor:
    """(x,y,z) float32 with the last voxels of each axis repeated up to a multiple of `factor`."""
    room = [r for n in reversed(values.shape) for r in (0, -n % factor)]
    return functional.pad(values[None, None], room, mode="replicate")[0, 0] if any(room) else values


def coarse_image(image: Tensor, factor: int) -> Tensor:
    """The mean of each cube's voxels; of a label's, what share of the cube is foreground.

    (x,y,z) float32 to (x',y',z'), each axis divided and rounded up.
    """
    if factor == 1:
        return image
    return functional.avg_pool3d(whole_cubes(image, factor)[None, None], factor)[0, 0]


def coarse_map(values: Tensor, factor: int) -> Tensor:
    """A distance map at the cubes' centres, by linear interpolation: (x,y,z) float32 to (x',y',z').

    Made of the fine label, it knows where the surface is between the coarse voxels. A transform of the coarse label
    does not: of simple shapes that costs 3.5 % at the contour (see README.md).
    """
    if factor == 1:
        return values
    cubes = whole_cubes(values, factor)
    # Without align_corners a sample is at its cube's centre.
    size = [n // factor for n in cubes.shape]
    return functional.interpolate(cubes[None, None], size, mode="trilinear", align_corners=False)[0, 0]


def fine_field(field: Tensor, factor: int, shape: Sequence[int]) -> Tensor:
    """Linear interpolation of values at the cubes' centres to all fine voxels: (x',y',z') to `shape`."""
    if factor == 1:
        return field
    x, y, z = shape
    fine = functional.interpolate(field[None, None], scale_factor=factor, mode="trilinear", align_corners=False)
    return fine[0, 0, :x, :y, :z]
