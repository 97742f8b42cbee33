"""Nearest foreground voxels: where a distance ends, and the label there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor

from sdm.kernels.edt.nearest_sites import nearest_sites
from sdm.runtime.operators import define
from sdm.runtime.torch_warp import as_warp, on_current_stream


class NearestVoxels(NamedTuple):
    """The foreground voxels that distances are measured to.

    Args:
        index: (...,3) int32, the nearest voxel's indices along x, y and z; -1 where there is none.
        label: Its label, in the type of the labels: the Voronoi map of the volume; 0 where there is none. Of several
            classes that of the nearest one, without the axis of classes.
    """

    index: Any
    label: Any


def _fake(mask: Tensor, spacing: Sequence[float], half: float) -> Tensor:
    return torch.empty((*mask.shape, 3), dtype=torch.int32, device=mask.device)


@define("nearest_voxels", _fake)
def nearest_voxels(mask: Tensor, spacing: Sequence[float], half: float) -> Tensor:
    """Indices (B,nx,ny,nz,3) int32 of the nearest foreground voxels of masks (B,nx,ny,nz); -1 where there are none."""
    mask = mask.contiguous()
    index = torch.empty((*mask.shape, 3), dtype=torch.int32, device=mask.device)
    sizes = (float(spacing[0]), float(spacing[1]), float(spacing[2]))
    with on_current_stream(mask, mask):
        for part, found in zip(mask, index, strict=True):
            kept = {
                name: torch.empty(part.numel(), dtype=torch.int32, device=mask.device)
                for name in ("heights", "between", "stack", "x", "y", "z")
            }
            room = {name: as_warp(tensor, wp.int32) for name, tensor in kept.items()}
            for name in ("heights", "between"):
                room[name] = as_warp(kept[name].view(torch.float32), wp.float32)
            source = as_warp(part.view(torch.uint8).reshape(-1), wp.uint8)
            nx, ny, nz = part.shape
            nearest_sites(source, (1, nx, ny, nz), sizes, half, room, as_warp(found.view(-1), wp.int32))
    return index


def labels_at(labels: Tensor, index: Tensor) -> Tensor:
    """Labels (B,nx,ny,nz) at indices (B,nx,ny,nz,3); 0 where these are -1."""
    _, _, ny, nz = labels.shape
    x, y, z = index.long().unbind(-1)
    flat = (x * ny + y) * nz + z
    found = labels.reshape(len(labels), -1).gather(1, flat.clamp(min=0).reshape(len(labels), -1)).reshape(labels.shape)
    return found.masked_fill(x < 0, 0)
