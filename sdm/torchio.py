"""A transform for TorchIO: `SignedDistanceMap`, which gives subjects the distance maps of their labels.

from sdm.torchio import SignedDistanceMap
tio.Compose([tio.RandomAffine(), SignedDistanceMap(classes=[1, 2, 3])])
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import torch

from sdm.core.to_libraries import imported
from sdm.losses.class_maps import class_maps

# By its name, as this module has the same.
_torchio: Any = imported("torchio", "torchio")


class SignedDistanceMap(_torchio.Transform):
    """Signed distance maps of a subject's label maps as images of it: `label` gives `label_sdm`, a channel each class.

    Distances are in millimetres, by the spacing of the image, and negative inside. Labels stay as they are. Put it
    after random spatial transforms: the map of a turned label is exact, a turned map is not.

    Args:
        classes: Of a label map with one channel: the values, their number, or "all" for those that are there but 0.
            None for masks, a channel each; of one channel everything but 0 is the class.
        surface: "faces" for the surface made of voxel faces, "centres" as SciPy measures.
        truncate: Cut distances to this on both sides. A class that is not there is so far away everywhere; without a
            truncation its map is 0.
        normalize: Scale to -1..1, see `sdm.losses.class_maps`.
        device: Where to compute; by default on the CPU, where TorchIO's images are.
        postfix: What a map's name has after its label's.
        options: Those of `torchio.Transform`: `p`, `include`, `exclude`, ...
    """

    def __init__(
        self,
        classes: Sequence[int] | int | Literal["all"] | None = None,
        *,
        surface: str = "faces",
        truncate: float | None = None,
        normalize: bool = False,
        device: str | torch.device | None = None,
        postfix: str = "sdm",
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.classes: Any = classes
        self.surface, self.truncate = surface, truncate
        self.normalize, self.device, self.postfix = normalize, device, postfix
        self.args_names = ["classes", "surface", "truncate", "normalize", "device", "postfix"]

    def apply_transform(self, subject: Any) -> Any:
        """The subject with the maps of its labels."""
        for name, image in subject.get_images_dict(intensity_only=False).items():
            wanted = (self.include is None or name in self.include) and name not in (self.exclude or ())
            if not (isinstance(image, _torchio.LabelMap) and wanted):
                continue
            data = image.data if self.device is None else image.data.to(self.device)
            maps = class_maps(
                data,
                [float(s) for s in image.spacing],
                classes=self.classes,
                surface=self.surface,
                truncate=self.truncate,
                normalize=self.normalize,
            )
            made = _torchio.ScalarImage(tensor=maps.cpu(), affine=image.affine)
            subject.add_image(made, f"{name}_{self.postfix}")
        return subject
