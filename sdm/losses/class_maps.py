"""Signed distance maps of every class of a label, as targets of networks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from sdm.core.given_values import real
from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.errors import GridError, SDMError
from sdm.losses.pair import require_tensors
from sdm.losses.targets import Spacing


def class_maps(
    labels: Tensor,
    spacing: Spacing = 1.0,
    *,
    classes: Sequence[int] | int | Literal["all"] | None = None,
    surface: str = "faces",
    truncate: float | None = None,
    normalize: bool = False,
) -> Tensor:
    """Signed distance maps of the classes of one sample, channels first, negative inside and finite everywhere.

    Args:
        labels: (1,x,y,z) or (x,y,z) labels, with `classes`; or (C,x,y,z) masks, one for each class.
        spacing: Size of a voxel along each axis, in the unit of the maps.
        classes: Values, their number, or "all", as for `sdm.euclidean_distance_transform`; 1 if there is one channel
            and nothing is given. Of masks None.
        surface: "faces" or "centres".
        truncate: Cut distances to this on both sides.
        normalize: Scale to -1..1: by `truncate` if it is given, else each class by its depth inside and its reach
            outside, as Xue et al. (AAAI 2020) do.

    Returns:
        (C,x,y,z) float32 on the labels' device. A class that is not there, or that fills the volume, has plus or minus
        `truncate` everywhere, and 0 where there is none.

    Raises:
        GridError: Another shape.
        SDMError: Classes for several channels, or a truncation that is not positive.
    """
    require_tensors(labels)
    if labels.ndim == 3:
        labels = labels[None]
    if labels.ndim != 4:
        raise GridError(f"labels of shape {tuple(labels.shape)} are no sample: give (1,x,y,z), (x,y,z) or (C,x,y,z)")
    if classes is not None and labels.shape[0] != 1:
        raise SDMError(f"{labels.shape[0]} channels are masks of a class each: leave out classes")
    if truncate is not None and not 0 < real(truncate) < math.inf:
        raise SDMError(f"the truncation {truncate!r} must be a positive distance")
    missing = 0.0 if truncate is None else float(truncate)
    if classes is None:
        maps = euclidean_distance_transform(labels, spacing, signed=True, surface=surface, missing=missing)
    else:
        maps = euclidean_distance_transform(
            labels[0], spacing, signed=True, surface=surface, missing=missing, classes=classes
        )
    if truncate is not None:
        maps = maps.clamp(-truncate, truncate)
        return maps / truncate if normalize else maps
    if not normalize:
        return maps
    inside, outside = (-maps).clamp(min=0), maps.clamp(min=0)
    deep, far = (side.flatten(1).amax(1).clamp(min=1e-12)[:, None, None, None] for side in (inside, outside))
    return torch.where(maps < 0, -inside / deep, outside / far)
