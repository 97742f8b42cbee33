"""Prediction: from an image to a label and its signed distance map."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.errors import SDMError
from sdm.segmentation.data.case import standardized
from sdm.segmentation.data.downsample import coarse_image, fine_field
from sdm.segmentation.infer.sliding_window import sliding_window
from sdm.segmentation.networks.model import SegmentationModel
from sdm.training.precision import bfloat16, layout


@dataclass(frozen=True)
class Prediction:
    """Label (x,y,z) bool; field (x,y,z) float32, negative inside, from which it was cut: see `SegmentationModel`."""

    label: Tensor
    field: Tensor


def predict(
    model: SegmentationModel,
    image: Tensor,
    window: Sequence[int],
    *,
    stride: Sequence[int] | None = None,
    largest: bool = True,
    mirrors: str = "",
    batch: int = 4,
) -> Prediction:
    """Segment an image by windows, where the network is.

    Args:
        model: A trained network; it is put into evaluation mode.
        image: (x,y,z) as read; it is standardised here.
        window: Voxels of a window, those of the training's patches; larger ones if the network is for those.
        stride: See `sliding_window`.
        largest: Keep only the largest connected component (by faces, edges and corners): for single organs.
        mirrors: Average over the mirror images of every window along these of the axes "xyz": twice the work for each.
            For networks that were trained on such images.
        batch: Windows at a time.
    """
    values = predicted_field(model, image, window, stride=stride, mirrors=mirrors, batch=batch)
    return prediction_of(values, largest=largest)


def predicted_field(
    model: SegmentationModel,
    image: Tensor,
    window: Sequence[int],
    *,
    stride: Sequence[int] | None = None,
    mirrors: str = "",
    batch: int = 4,
) -> Tensor:
    """Field of an image (x,y,z) by a network, before it is cut at zero: see `predict`, `SegmentationModel.field`."""
    values = coarse_field(model, image, window, stride=stride, mirrors=mirrors, batch=batch)
    with torch.inference_mode():
        return fine_field(values, model.coarsen, image.shape)


def coarse_field(
    model: SegmentationModel,
    image: Tensor,
    window: Sequence[int],
    *,
    stride: Sequence[int] | None = None,
    mirrors: str = "",
    batch: int = 4,
) -> Tensor:
    """The same before it is enlarged: at the centres of the larger voxels (x',y',z') that the network sees."""
    model.eval()
    device = next(model.parameters()).device
    images = _mirror_images(mirrors)

    def field(windows: Tensor) -> Tensor:
        if windows.is_cuda:
            windows = windows.to(memory_format=layout(use=True))
        with bfloat16(device, device.type == "cuda"):
            seen = [model.field(windows.flip(axes)).flip(axes) for axes in images]
        return torch.stack(seen).mean(0)

    with torch.inference_mode():
        seen = standardized(coarse_image(image.to(device), model.coarsen))
        return sliding_window(field, seen, window, stride=stride, batch=batch, position=model.position)


def prediction_of(values: Tensor, *, largest: bool) -> Prediction:
    """A field (x,y,z), cut at zero."""
    label = values < 0
    return Prediction(largest_component(label) if largest else label, values)


def _mirror_images(axes: str) -> list[tuple[int, ...]]:
    """The dimensions of (B,C,x,y,z) that each mirror image turns round, none for the first."""
    turned = [2 + "xyz".index(axis) for axis in sorted(set(axes))]
    return [chosen for count in range(len(turned) + 1) for chosen in itertools.combinations(turned, count)]


def largest_component(label: Tensor) -> Tensor:
    """The largest 26-connected component of a mask (x,y,z), on its device; empty if it is.

    Raises:
        SDMError: It is no tensor (x,y,z).
    """
    if not isinstance(label, Tensor) or label.ndim != 3:
        raise SDMError(f"an object of type {type(label).__name__} is no mask: give a tensor (x,y,z)")
    parts, count = ndimage.label(label.cpu().numpy(), structure=np.ones((3, 3, 3)))  # type: ignore[misc]
    if count <= 1:
        return label
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    return torch.from_numpy(parts == sizes.argmax()).to(label.device)


def label_distance_map(label: Tensor, spacing: Sequence[float]) -> Tensor:
    """Exact signed distance map of a label (x,y,z) in the spacing's unit: negative inside, 0 on the voxels' faces.

    Infinite everywhere if the label is empty.
    """
    return euclidean_distance_transform(label, spacing, signed=True, surface="faces")
