"""Transform of batchgeneratorsv2 that makes distance maps of the segmentation as the regression target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import torch

from sdm.core.to_libraries import imported
from sdm.losses.class_maps import class_maps

_base: Any = imported("batchgeneratorsv2.transforms.base.basic_transform", "batchgeneratorsv2")


class SignedDistanceTarget(_base.BasicTransform):
    """`regression_target` (C,...) of a sample: the signed distance maps of the classes of its `segmentation`.

    Put it after random spatial transforms, which would turn a map, not the map of what is turned, and after
    `RemoveLabelTransform(-1, 0)`. Two dimensions or three. A regression target that is there already keeps its
    channels, before the maps.

    Args:
        classes: Of the segmentation's channel: the values, their number, or "all" for those that are there but 0. None
            for masks, a channel each.
        spacing: Size of a voxel along each axis of the arrays, in the unit of the maps.
        channel: The segmentation's channel that `classes` are in.
        surface: "faces" for the surface made of voxel faces, "centres" as SciPy measures.
        truncate: Cut distances to this on both sides.
        normalize: Scale to -1..1, see `sdm.losses.class_maps`.
        device: Where to compute; by default where the segmentation is. The maps come back.
    """

    def __init__(
        self,
        classes: Sequence[int] | int | Literal["all"] | None = None,
        *,
        spacing: float | Sequence[float] = 1.0,
        channel: int = 0,
        surface: str = "faces",
        truncate: float | None = None,
        normalize: bool = False,
        device: str | torch.device | None = None,
    ) -> None:
        super().__init__()
        self.classes: Any = classes
        self.spacing: Any = spacing
        self.channel = channel
        self.surface, self.truncate, self.normalize, self.device = surface, truncate, normalize, device

    def apply(self, data_dict: dict[str, Any], **params: Any) -> dict[str, Any]:
        """The sample with the maps."""
        labels = torch.as_tensor(data_dict["segmentation"])
        here = labels if self.classes is None else labels[self.channel][None]
        is_flat = here.ndim == 3
        spacing: Any = self.spacing
        if is_flat:
            # One layer; nothing lies beyond it.
            here = here[:, None]
            spacing = spacing if isinstance(spacing, int | float) else [max(spacing), *spacing]
        maps = class_maps(
            here if self.device is None else here.to(self.device),
            spacing,
            classes=self.classes,
            surface=self.surface,
            truncate=self.truncate,
            normalize=self.normalize,
        ).to(labels.device)
        maps = maps[:, 0] if is_flat else maps
        before = data_dict.get("regression_target")
        data_dict["regression_target"] = maps if before is None else torch.cat([torch.as_tensor(before), maps])
        return data_dict
