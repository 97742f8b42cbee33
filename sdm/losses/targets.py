"""Distance maps of labels, as losses and regression heads want them: finite, whatever the label."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.errors import SDMError

Spacing = float | Sequence[float]
PUBLISHED = "published"


def signed_distance_target(mask: Tensor, spacing: Spacing = 1.0, *, surface: str = "faces") -> Tensor:
    """Signed distance map of a label, negative inside; 0 everywhere where the label is empty or full.

    `surface` is "faces" or "centres" as in `euclidean_distance_transform`, or "published": the map of the public
    code of Kervadec et al. and Ma et al., where the foreground voxels next to the background lie on the surface. It
    is the one for "centres" with 1 taken off the depth inside, whatever the spacing, so use spacing 1 with it.

    Args:
        mask: (B,1,x,y,z), foreground not zero.
        spacing: Size of a voxel along each axis; the map is in its unit.
        surface: See above.

    Returns:
        (B,1,x,y,z) float32.
    """
    published = surface == PUBLISHED
    where = "centres" if published else surface
    distance = euclidean_distance_transform(mask, spacing, signed=True, surface=where, missing=0.0)
    return torch.where(distance < 0, distance + 1.0, distance) if published else distance


def foreground_distance(mask: Tensor, spacing: Spacing = 1.0, *, normalized: bool = False) -> Tensor:
    """Distance of each foreground voxel from the background, 0 outside (Ma's "DTM of the foreground").

    Args:
        mask: (B,1,x,y,z), foreground not zero.
        spacing: Size of a voxel along each axis.
        normalized: Divide by the largest of each sample, so that it lies in 0..1.

    Returns:
        (B,1,x,y,z) float32; 0 where the label is empty or full.

    Raises:
        SDMError: One label without a batch, (x,y,z), is to be normalised.
    """
    distance = euclidean_distance_transform(mask == 0, spacing, missing=0.0)
    return distance / _largest(distance) if normalized else distance


def normalized_signed_distance(mask: Tensor, spacing: Spacing = 1.0, *, surface: str = "faces") -> Tensor:
    """Signed distance map whose inside is divided by its depth and whose outside by its reach: -1..1.

    The SDF of Xue et al. (AAAI 2020) and of Ma et al. (MIDL 2020), per sample. With `surface="published"` the
    foreground voxels that share a face with the background are 0, as in their code; that keeps its scale of 1.

    Args:
        mask: (B,1,x,y,z), foreground not zero.
        spacing: Size of a voxel along each axis; the published code ignores it.
        surface: "faces", "centres" or "published".

    Returns:
        (B,1,x,y,z) float32; 0 where the label is empty or full.

    Raises:
        SDMError: One label without a batch, (x,y,z).
    """
    published = surface == PUBLISHED
    where = "centres" if published else surface
    distance = euclidean_distance_transform(mask, spacing, signed=True, surface=where, missing=0.0)
    inside, outside = (-distance).clamp(min=0), distance.clamp(min=0)
    scaled = outside / _largest(outside) - inside / _largest(inside)
    return scaled.masked_fill(inner_boundary(mask), 0.0) if published else scaled


def inner_boundary(mask: Tensor) -> Tensor:
    """Foreground voxels of (B,1,x,y,z) that share a face with a background voxel."""
    if mask.ndim != 5:
        raise SDMError(f"a label of shape {tuple(mask.shape)} is not (B,1,x,y,z)")
    inside = mask != 0
    touching = torch.zeros_like(inside)
    for axis in (2, 3, 4):
        count = mask.shape[axis] - 1
        first, second = inside.narrow(axis, 0, count), inside.narrow(axis, 1, count)
        touching.narrow(axis, 0, count).logical_or_(~second)
        touching.narrow(axis, 1, count).logical_or_(~first)
    return touching & inside


def _largest(distance: Tensor) -> Tensor:
    if distance.ndim == 3:
        # Each of its slices would have a scale of its own.
        raise SDMError(f"a label of shape {tuple(distance.shape)} has no batch: give (B,1,x,y,z)")
    # Zero only where the side is empty, and then the numerator is zero as well.
    return distance.flatten(1).amax(1).clamp(min=1e-12).view(-1, *[1] * (distance.ndim - 1))
