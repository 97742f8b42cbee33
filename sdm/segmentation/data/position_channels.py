"""Positions of voxels in their volume, as further channels for a network that sees a patch alone."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

CHANNELS = 3


def position_frame(matrix: Tensor, centre: Tensor, size: Sequence[int], shape: Sequence[int]) -> Tensor:
    """Affine map of positions through a patch: (3,4) float64 for `positions`.

    Args:
        matrix: (3,3) from offsets in voxels of the patch to those of the volume: the identity for a copy, else what
            turns, scales or mirrors it.
        centre: (3,) voxel indices in the volume, fractions too, where the middle of the patch is.
        size: Voxels of the patch along each axis.
        shape: Voxels of the volume along each axis, without what pads it.
    """
    half = (torch.tensor(size, dtype=torch.float64, device="cpu") - 1) / 2
    scale = 2 / torch.tensor(shape, dtype=torch.float64, device="cpu")
    return torch.cat([scale[:, None] * matrix * half[None], (scale * (centre + 0.5) - 1)[:, None]], 1)


def positions(frames: Tensor, size: Sequence[int]) -> Tensor:
    """Positions of the voxels of patches along each axis of their volumes, (B,3,x,y,z).

    The centre of voxel i of n is at 2 (i + 1/2) / n - 1, so that -1 and 1 are the volume's two faces; what pads a
    volume lies beyond them. Positions are those of the tissue, whichever way a patch is turned, scaled or mirrored.

    Args:
        frames: (B,3,4) of `position_frame`, on the device and of the type of the result.
        size: Voxels of a patch along each axis.
    """
    found = frames[..., 3, None, None, None]
    for axis, count in enumerate(size):
        line = torch.linspace(-1, 1, count, device=frames.device, dtype=frames.dtype)
        along = line.view([count if a == axis else 1 for a in range(3)])
        found = found + frames[..., axis, None, None, None] * along
    return found
