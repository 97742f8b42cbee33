"""Transforms for MONAI: `SignedDistanceMap` and, for dictionaries, `SignedDistanceMapd`.

    from sdm.monai import SignedDistanceMapd
    Compose([LoadImaged("label"), EnsureChannelFirstd("label"), SignedDistanceMapd("label", classes=[1, 2, 3])])

Deterministic, so a spatial transform comes before it, not after: a rotated map of distances is near, not equal, to the
map of the rotated label. Where the label is on a GPU the maps are computed there.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
import torch

from sdm.core.to_libraries import imported
from sdm.losses.class_maps import class_maps

# By its name, as this module has the same.
_transforms: Any = imported("monai.transforms", "monai")
_MetaTensor: Any = imported("monai.data", "monai").MetaTensor
_backends: Any = imported("monai.utils", "monai").TransformBackends


class SignedDistanceMap(_transforms.Transform):
    """The signed distance maps of a label's classes, in millimetres, negative inside.

    Args:
        classes: Of a label with one channel: the values, their number, or "all" for those that are there but 0. None
            for masks, a channel each; of one channel everything but 0 is the class.
        spacing: Size of a voxel along each axis; None for that of the label's affine matrix, and 1 if it has none.
        surface: "faces" for the surface made of voxel faces, "centres" as SciPy measures.
        truncate: Cut distances to this on both sides. A class that is not there is so far away everywhere; without a
            truncation its map is 0.
        normalize: Scale to -1..1, see `sdm.losses.class_maps`.
        device: Where to compute; by default where the label is. The maps come to be there.
    """

    backend = [_backends.TORCH]  # noqa: RUF012 (MONAI declares it so)

    def __init__(
        self,
        classes: Sequence[int] | int | Literal["all"] | None = None,
        *,
        spacing: float | Sequence[float] | None = None,
        surface: str = "faces",
        truncate: float | None = None,
        normalize: bool = False,
        device: str | torch.device | None = None,
    ) -> None:
        self.spacing, self.device = spacing, device
        self.options: dict[str, Any] = {
            "classes": classes,
            "surface": surface,
            "truncate": truncate,
            "normalize": normalize,
        }

    def __call__(self, label: Any) -> Any:
        """Maps (C,x,y,z) float32 of a label (1,x,y,z) or masks (C,x,y,z): a `MetaTensor` with its affine of one."""
        meta: Any = label if isinstance(label, _MetaTensor) else None
        if meta is not None:
            plain = meta.as_tensor()
        else:
            plain = label if isinstance(label, torch.Tensor) else torch.from_numpy(np.array(label))
        spacing = self.spacing
        if spacing is None:
            spacing = 1.0 if meta is None else [float(s) for s in meta.pixdim]
        maps = class_maps(plain if self.device is None else plain.to(self.device), spacing, **self.options)
        if meta is not None:
            # Its metadata has the affine matrix.
            return _MetaTensor(maps, meta=dict(meta.meta), applied_operations=list(meta.applied_operations))
        return maps if isinstance(label, torch.Tensor) else maps.cpu().numpy()


class SignedDistanceMapd(_transforms.MapTransform):
    """`SignedDistanceMap` of entries of a dictionary, beside the labels: `label` gives `label_sdm`.

    Args:
        keys: The labels' keys.
        classes: As of `SignedDistanceMap`, with the options that follow.
        spacing: See there.
        surface: See there.
        truncate: See there.
        normalize: See there.
        device: See there.
        postfix: What a map's key has after its label's; None to replace the label.
        allow_missing_keys: Leave out keys that are not there.
    """

    backend = SignedDistanceMap.backend

    def __init__(
        self,
        keys: Hashable | Sequence[Hashable],
        classes: Sequence[int] | int | Literal["all"] | None = None,
        *,
        spacing: float | Sequence[float] | None = None,
        surface: str = "faces",
        truncate: float | None = None,
        normalize: bool = False,
        device: str | torch.device | None = None,
        postfix: str | None = "sdm",
        allow_missing_keys: bool = False,
    ) -> None:
        super().__init__(keys, allow_missing_keys)
        self.postfix = postfix
        self.transform = SignedDistanceMap(
            classes, spacing=spacing, surface=surface, truncate=truncate, normalize=normalize, device=device
        )

    def __call__(self, data: Mapping[Hashable, Any]) -> dict[Hashable, Any]:
        """The dictionary with the maps."""
        found = dict(data)
        for key in self.key_iterator(found):
            found[key if self.postfix is None else f"{key}_{self.postfix}"] = self.transform(data[key])
        return found


SignedDistanceMapD = SignedDistanceMapDict = SignedDistanceMapd
