"""Distances between the surfaces of two masks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from sdm.engine.distance_transform import euclidean_distance_transform, spacing_of
from sdm.errors import SDMError
from sdm.metrics.masks import Mask, masks


class SurfaceDistances(NamedTuple):
    """Distances in mm, float32: of each surface voxel of one mask from the nearest one of the other."""

    from_prediction: Tensor
    from_truth: Tensor


def surface_voxels(mask: Tensor) -> Tensor:
    """Foreground voxels with a face on the background or on the volume's border: bool (x,y,z).

    The definition of MONAI and of SciPy's `mask & ~binary_erosion(mask)`.

    Raises:
        SDMError: No tensor (x,y,z).
    """
    if not isinstance(mask, Tensor) or mask.ndim != 3:
        raise SDMError(f"an object of type {type(mask).__name__} is no volume: give a tensor (x,y,z)")
    inside = mask != 0
    around = functional.pad(inside, (1, 1, 1, 1, 1, 1))
    buried = inside.clone()
    for axis in range(3):
        count = mask.shape[axis]
        middle = around
        for other in range(3):
            if other != axis:
                middle = middle.narrow(other, 1, mask.shape[other])
        buried &= middle.narrow(axis, 0, count) & middle.narrow(axis, 2, count)
    return inside & ~buried


def surface_distances(prediction: Mask, truth: Mask, spacing_mm: float | Sequence[float]) -> SurfaceDistances:
    """Distances between the surface voxels of two masks, centre to centre, both ways.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.
        spacing_mm: Size of a voxel along each axis in mm, or one number.

    Returns:
        One value for each surface voxel; all infinite where the other mask is empty, none where the mask itself is.
    """
    prediction, truth = masks(prediction, truth)
    spacing = spacing_of(spacing_mm)
    box = foreground_box(prediction | truth)
    surface = surface_voxels(prediction)[box], surface_voxels(truth)[box]
    to_prediction, to_truth = (euclidean_distance_transform(s, spacing, missing=math.inf) for s in surface)
    return SurfaceDistances(to_truth[surface[0]], to_prediction[surface[1]])


def foreground_box(mask: Tensor) -> tuple[slice, slice, slice]:
    """The part of the volume that holds all foreground; one voxel if there is none."""
    slices = []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        index = torch.nonzero(mask.any(others[1]).any(others[0]))
        slices.append(slice(int(index.min()), int(index.max()) + 1) if index.numel() else slice(0, 1))
    return (slices[0], slices[1], slices[2])
