"""Summaries of the distances between two surfaces, in millimetres.

Each takes two masks (x,y,z) and their voxels' size in mm, and is infinite where exactly one mask is empty and NaN
where both are. See `surface_distances` for what is measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from sdm.core.given_values import real
from sdm.errors import SDMError
from sdm.metrics.masks import Mask
from sdm.metrics.surface_voxels import SurfaceDistances, surface_distances

Spacing = float | Sequence[float]


def hausdorff_distance(prediction: Mask, truth: Mask, spacing_mm: Spacing, percentile: float = 95.0) -> float:
    """The larger of the two directions' percentiles of surface distances in mm: the 95 % Hausdorff distance.

    As in MONAI. Percentiles are interpolated linearly; 100 is the Hausdorff distance itself.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.
        spacing_mm: Size of a voxel along each axis [mm].
        percentile: 0 to 100.

    Returns:
        Infinite where one of the masks is empty, NaN where both are.

    Raises:
        SDMError: Another percentile, or masks that do not fit together.
    """
    return hausdorff_of(surface_distances(prediction, truth, spacing_mm), percentile)


def average_surface_distance(prediction: Mask, truth: Mask, spacing_mm: Spacing) -> float:
    """Average symmetric surface distance in mm: the mean over all surface voxels of both masks.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.
        spacing_mm: Size of a voxel along each axis [mm].

    Returns:
        Infinite where one of the masks is empty, NaN where both are.
    """
    return average_of(surface_distances(prediction, truth, spacing_mm))


def rms_surface_distance(prediction: Mask, truth: Mask, spacing_mm: Spacing) -> float:
    """Root mean square symmetric surface distance in mm, over all surface voxels of both masks.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.
        spacing_mm: Size of a voxel along each axis [mm].

    Returns:
        Infinite where one of the masks is empty, NaN where both are.
    """
    return rms_of(surface_distances(prediction, truth, spacing_mm))


def hausdorff_of(distances: SurfaceDistances, percentile: float = 95.0) -> float:
    """`hausdorff_distance` of distances known already."""
    if not 0 <= real(percentile) <= 100:
        raise SDMError(f"a percentile is between 0 and 100, not {percentile!r}")
    without = _without_surface(distances)
    return max(_percentile(d, percentile) for d in distances) if without is None else without


def average_of(distances: SurfaceDistances) -> float:
    """`average_surface_distance` of distances known already."""
    without = _without_surface(distances)
    return float(torch.cat(list(distances)).double().mean()) if without is None else without


def rms_of(distances: SurfaceDistances) -> float:
    """`rms_surface_distance` of distances known already."""
    without = _without_surface(distances)
    return float(torch.cat(list(distances)).double().square().mean().sqrt()) if without is None else without


def _without_surface(distances: SurfaceDistances) -> float | None:
    empty = [d.numel() == 0 for d in distances]
    return math.nan if all(empty) else math.inf if any(empty) else None


def _percentile(values: Tensor, percentile: float) -> float:
    # torch.quantile refuses more than 2^24 values.
    ordered = values.double().sort().values
    at = percentile / 100.0 * (len(ordered) - 1)
    low = math.floor(at)
    below, above = float(ordered[low]), float(ordered[min(low + 1, len(ordered) - 1)])
    return below + (at - low) * (above - below)
