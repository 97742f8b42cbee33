"""The same pipeline in each library: turn and scale labels at random, then maps by sdm, by SciPy, or none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

# From labels (1,x,y,z) and a seed to maps (C,x,y,z), or labels.
Pipeline = Callable[[torch.Tensor, int], Any]
TURN = 0.3  # rad
SCALE = 0.1


def scipy_maps(labels: Any, classes: int, spacing: Sequence[float]) -> torch.Tensor:
    """Signed distances (C,x,y,z) as a user of SciPy writes them: to the nearest voxel of the other side, by centres."""
    from scipy.ndimage import distance_transform_edt

    plain = np.asarray(torch.as_tensor(labels).cpu())[0]
    found = []
    for value in range(1, classes + 1):
        inside = plain == value
        if not inside.any():
            found.append(np.zeros(plain.shape, np.float32))
            continue
        transform: Any = distance_transform_edt
        outward = transform(~inside, spacing) - transform(inside, spacing)
        found.append(outward.astype(np.float32))
    return torch.from_numpy(np.stack(found))


def monai(kind: str, classes: int, spacing: Sequence[float], device: str) -> Pipeline:
    from monai.data import MetaTensor
    from monai.transforms import Compose, RandAffined

    from sdm.monai import SignedDistanceMapd

    turned = RandAffined(
        "label",
        prob=1.0,
        rotate_range=(TURN,) * 3,
        scale_range=(SCALE,) * 3,
        mode="nearest",
        padding_mode="zeros",
        device=device,
    )
    steps: list[Any] = [turned]
    if kind == "sdm":
        steps.append(SignedDistanceMapd("label", classes=classes, spacing=spacing, surface="centres"))
    whole = Compose(steps)
    affine = torch.diag(torch.tensor([*spacing, 1.0]))

    def run(labels: torch.Tensor, seed: int) -> Any:
        whole.set_random_state(seed)
        made = whole({"label": MetaTensor(labels.to(device), affine=affine)})
        if kind == "SciPy":
            # Back to where the training is.
            return scipy_maps(made["label"].as_tensor(), classes, spacing).to(device)
        return made["label_sdm" if kind == "sdm" else "label"].as_tensor()

    return run


def torchio(kind: str, classes: int, spacing: Sequence[float], device: str) -> Pipeline:
    import torchio as tio

    from sdm.torchio import SignedDistanceMap

    steps: list[Any] = [tio.RandomAffine(scales=SCALE, degrees=np.degrees(TURN))]
    if kind == "sdm":
        steps.append(SignedDistanceMap(classes, surface="centres", device=device))
    whole = tio.Compose(steps)

    def run(labels: torch.Tensor, seed: int) -> Any:
        subject = tio.Subject(label=tio.LabelMap(tensor=labels, affine=np.diag([*spacing, 1.0])))
        made = whole(subject)
        if kind == "SciPy":
            return scipy_maps(made["label"].data, classes, spacing)
        return made["label_sdm" if kind == "sdm" else "label"].data

    return run


def batchgenerators(kind: str, classes: int, spacing: Sequence[float], device: str) -> Pipeline:
    from batchgeneratorsv2.transforms.spatial.spatial import SpatialTransform
    from batchgeneratorsv2.transforms.utils.compose import ComposeTransforms

    from sdm.nnunet import SignedDistanceTarget

    def run(labels: torch.Tensor, seed: int) -> Any:
        turn = SpatialTransform(
            tuple(labels.shape[1:]),
            0,
            False,
            p_rotation=1.0,
            rotation=(-TURN, TURN),
            p_scaling=1.0,
            scaling=(1 - SCALE, 1 + SCALE),
            p_synchronize_scaling_across_axes=1,
            bg_style_seg_sampling=False,
        )
        steps: list[Any] = [turn]
        if kind == "sdm":
            steps.append(SignedDistanceTarget(classes, spacing=spacing, surface="centres", device=device))
        made = ComposeTransforms(steps)(image=labels.float(), segmentation=labels.to(torch.int16))
        if kind == "SciPy":
            return scipy_maps(made["segmentation"], classes, spacing)
        return made["regression_target" if kind == "sdm" else "segmentation"]

    return run


LIBRARIES: dict[str, Callable[[str, int, Sequence[float], str], Pipeline]] = {
    "MONAI": monai,
    "TorchIO": torchio,
    "batchgeneratorsv2": batchgenerators,
}
