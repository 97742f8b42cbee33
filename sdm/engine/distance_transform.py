"""Exact Euclidean distance transform of label volumes, where the tensor is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.errors import GridError, SDMError
from sdm.kernels.edt import transform
from sdm.kernels.edt.envelopes import LONGEST_LINE
from sdm.runtime.operators import define
from sdm.runtime.torch_warp import as_warp, on_current_stream

# What "surface" means: how far the surface of a voxel is from its centre, in voxels.
SURFACES = {"centres": 0.0, "faces": 0.5}
# Kernels count the voxels of a launch in 32 bits, and a GPU uses 32 threads a row.
MOST_VOXELS = (1 << 31) - 1
_LANES = 32


def _fake_transform(mask: Tensor, spacing: Sequence[float], half: float, signed: bool, missing: float) -> Tensor:
    return torch.empty(mask.shape, dtype=torch.float32, device=mask.device)


@define("euclidean_distance_transform", _fake_transform)
def _transform(mask: Tensor, spacing: Sequence[float], half: float, signed: bool, missing: float) -> Tensor:
    """Distances (B,nx,ny,nz) float32 from bool (B,nx,ny,nz); see `euclidean_distance_transform`."""
    mask = mask.contiguous()
    out = torch.empty(mask.shape, dtype=torch.float32, device=mask.device)
    count, nx, ny, nz = mask.shape
    largest = nx * ny * max(nz, _LANES)
    chunk = max(1, min(count, MOST_VOXELS // largest))
    sizes = (float(spacing[0]), float(spacing[1]), float(spacing[2]))
    on_host = mask.device.type == "cpu"
    # One by one on a CPU, where a volume fills the cores, and only its slices with foreground need all passes.
    chunk = 1 if on_host else chunk
    with on_current_stream(mask, mask):
        for begin in range(0, count, chunk):
            part = mask[begin : begin + chunk]
            result = out[begin : begin + chunk]
            span = _span(part[0]) if on_host else None
            if span == (0, 0):
                result.fill_(missing)
                continue
            shape = (part.shape[0], nx, ny, nz)
            kept = {
                name: torch.empty(length, dtype=torch.int32, device=mask.device)
                for name, length in transform.room_for(shape, signed).items()
            }
            kept["marks"].zero_()
            between = kept["between"].view(torch.float32)
            if span is not None and span != (0, nx):
                between[: span[0] * ny * nz] = torch.inf
                between[span[1] * ny * nz :] = torch.inf
            room = {name: as_warp(tensor, wp.int32) for name, tensor in kept.items()}
            room["between"] = as_warp(between, wp.float32)
            source = as_warp(part.view(torch.uint8).reshape(-1), wp.uint8)
            flat = as_warp(result.reshape(-1), wp.float32)
            transform.transform(source, shape, sizes, half, signed, missing, room, flat, span)
    return out


def _span(mask: Tensor) -> tuple[int, int]:
    """The first slice along x with foreground, and the one after the last; (0, 0) where there is none."""
    found = np.flatnonzero(mask.numpy().any((1, 2)))
    return (int(found[0]), int(found[-1]) + 1) if len(found) else (0, 0)


@overload
def euclidean_distance_transform(
    mask: np.ndarray,
    spacing: float | Sequence[float] = 1.0,
    *,
    signed: bool = False,
    surface: str = "centres",
    missing: float = math.inf,
) -> np.ndarray: ...
@overload
def euclidean_distance_transform(
    mask: Tensor,
    spacing: float | Sequence[float] = 1.0,
    *,
    signed: bool = False,
    surface: str = "centres",
    missing: float = math.inf,
) -> Tensor: ...
def euclidean_distance_transform(
    mask: Tensor | np.ndarray,
    spacing: float | Sequence[float] = 1.0,
    *,
    signed: bool = False,
    surface: str = "centres",
    missing: float = math.inf,
) -> Tensor | np.ndarray:
    """Exact distance of every voxel's centre from the foreground of a binary volume, on the mask's device.

    Unsigned, a voxel of the foreground has 0 and any other the distance from the nearest foreground voxel; SciPy's
    `distance_transform_edt(a)` is this transform of `a == 0`. Signed, a voxel outside has that same distance and a
    voxel inside minus its distance from the nearest background voxel. What lies beyond the volume is neither.

    With `surface="centres"` a distance ends at the other voxel's centre, as in SciPy: two neighbours along an axis
    are one spacing apart, and no signed value lies between minus and plus the smallest spacing. With
    `surface="faces"` it ends at the nearest point of the other voxel's box, so the signed map is that of the surface
    made of voxel faces, and two neighbours across it have minus and plus half a spacing.

    Separable and linear in the number of voxels: A. Meijster, J. Roerdink, W. Hesselink, "A general algorithm for
    computing distance transforms in linear time", 2000. Nothing waits for the device. Besides the result, 8 bytes a
    voxel are used while it runs.

    Args:
        mask: (x,y,z), (B,x,y,z) or (B,1,x,y,z); bool, or numbers of which those that are not zero are foreground. At
            most 32767 voxels along an axis. A tensor, or a NumPy array, which is measured on the CPU.
        spacing: Size of a voxel along each axis, in the unit that the distances shall have; one number for all axes.
        signed: Whether the inside has negative distances, rather than 0.
        surface: "centres" or "faces".
        missing: The distance where there is no voxel to measure to: all of a mask without foreground has `missing`,
            and, signed, all of one without background `-missing`.

    Returns:
        float32 of the mask's shape, NumPy for NumPy. Correct to a few roundings; not differentiable, since a mask is
        not.

    Raises:
        GridError: The shape or the spacing cannot be used.
        SDMError: `surface` is neither of the two, or the mask holds no numbers.
    """
    if not isinstance(mask, Tensor):
        values = _of_host(mask)
        return euclidean_distance_transform(values, spacing, signed=signed, surface=surface, missing=missing).numpy()
    if not 3 <= mask.ndim <= 5 or (mask.ndim == 5 and mask.shape[1] != 1):
        raise GridError(
            f"a mask of shape {tuple(mask.shape)} has no distance transform: give (x,y,z), (B,x,y,z) or (B,1,x,y,z)"
        )
    size = spacing_of(spacing)
    if surface not in SURFACES:
        raise SDMError(f"the surface {surface!r} is unknown: choose 'centres' or 'faces'")
    shape = mask.shape[-3:]
    if max(shape) > LONGEST_LINE or shape[0] * shape[1] * max(shape[2], _LANES) > MOST_VOXELS:
        raise GridError(
            f"a volume of shape {tuple(shape)} is too large: at most {LONGEST_LINE} voxels along an axis and "
            f"{MOST_VOXELS} in all"
        )
    if not mask.numel():
        return torch.empty(mask.shape, dtype=torch.float32, device=mask.device)
    inside = mask.detach()
    inside = inside if inside.dtype == torch.bool else inside != 0
    return torch.ops.sdm.euclidean_distance_transform(
        inside.reshape(-1, *shape), size, SURFACES[surface], signed, missing
    ).reshape(mask.shape)


def _of_host(mask: Any) -> Tensor:
    """A mask as bool."""
    values = np.asarray(mask)
    if values.dtype.kind not in "buif":
        raise SDMError(f"a mask holds numbers or truth values, not {values.dtype}: give a tensor or a NumPy array")
    return torch.from_numpy(values != 0)


def spacing_of(spacing: float | Sequence[float]) -> list[float]:
    """Three voxel sizes from one or three numbers.

    Raises:
        GridError: They are not three positive, finite numbers, or so different that their squares leave float32.
    """
    # One number may be NumPy's or a tensor, which are no floats.
    each: Any = [spacing] * 3 if np.ndim(spacing) == 0 else spacing
    sizes = [float(s) for s in each]
    if len(sizes) != 3 or not all(s > 0 and math.isfinite(s) for s in sizes):
        raise GridError(f"the spacing {spacing} must be one or three positive numbers")
    if max(sizes) > 1e9 * min(sizes):
        raise GridError(f"the spacing {spacing} differs too much between the axes: by at most a factor of 1e9")
    return sizes
