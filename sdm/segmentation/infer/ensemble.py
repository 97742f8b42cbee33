"""Ensemble of networks: the mean of their outputs, thresholded once."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from sdm.errors import SDMError
from sdm.segmentation.data.checks import same_spacing, voxel
from sdm.segmentation.infer.predict import Prediction, predicted_field, prediction_of
from sdm.segmentation.train.checkpoint import TrainedModel
from sdm.segmentation.train.methods import METHODS


def predict_ensemble(
    models: Sequence[TrainedModel],
    image: Tensor,
    *,
    window: Sequence[int] | None = None,
    stride: Sequence[int] | None = None,
    largest: bool = True,
    mirrors: bool = False,
    batch: int = 4,
) -> Prediction:
    """Segment an image by the mean of what several networks say of each voxel.

    Probabilities are averaged and cut at one half, or signed distances of one scale, cut at zero. So a mistake that few
    of them share is outvoted, and a network that is sure counts for more than one that is not, but never for much more:
    probabilities are bounded, and so are the distances that networks are trained on, -1..1.

    Networks see the image one after the other, each through windows of its own, so they may differ in patch, `coarsen`,
    network, method and `position`, and take no more memory than one of them and a volume. One alone says what `predict`
    says.

    Args:
        models: Trained networks; for instance the same method with several seeds.
        image: (x,y,z) as read.
        window: Voxels of a window of all networks; each the patches of its training if not given.
        stride: See `sliding_window`.
        largest: Keep only the largest connected component of the mean.
        mirrors: Let each network average over the mirror images that it has seen in its training.
        batch: Windows at a time.

    Returns:
        Label and mean field, where the first network is.

    Raises:
        SDMError: See `check_ensemble`.
    """
    check_ensemble(models)

    def said(trained: TrainedModel) -> Tensor:
        own = trained.settings
        axes = own.mirrored if mirrors else ""
        return predicted_field(trained.model, image, window or own.patch, stride=stride, mirrors=axes, batch=batch)

    with torch.inference_mode():
        mean = said(models[0])
        for trained in models[1:]:
            mean += said(trained).to(mean.device)
        mean /= len(models)
    return prediction_of(mean, largest=largest)


def check_ensemble(models: Sequence[TrainedModel], names: Sequence[object] | None = None) -> None:
    """Refuse networks whose fields cannot be averaged.

    Args:
        models: Trained networks.
        names: How a message calls them, such as their files; their numbers if not given.

    Raises:
        SDMError: There is none; two say different quantities, such as a probability and a distance; or two were
            trained on voxels of different sizes, which no image can have at once.
    """
    if not models:
        raise SDMError("an ensemble needs a network: give at least one")
    called = [str(n) for n in names] if names is not None else [f"network {i + 1}" for i in range(len(models))]
    first, told = models[0], _quantity(models[0])
    for name, other in zip(called[1:], models[1:], strict=True):
        if _quantity(other) != told:
            raise SDMError(
                f"{called[0]} says {told} and {name} {_quantity(other)}, which have no mean: "
                "take networks that say the same"
            )
        if not same_spacing(other.spacing, first.spacing):
            raise SDMError(
                f"{called[0]} was trained on voxels of {voxel(first.spacing)} mm and {name} on those of "
                f"{voxel(other.spacing)} mm: take networks for the same images"
            )


def _quantity(trained: TrainedModel) -> str:
    """Name of the quantity that a network's field is, so that those that have no mean differ."""
    method = METHODS[trained.settings.method]
    if method.output == "logit":
        return "a probability"
    # A normalised map of a patch has another scale in each; a clipped one as published counts voxels, not mm.
    of = "cases" if trained.settings.targets == "case" else "patches"
    larger = trained.settings.coarsen
    voxels = f" in voxels {larger} times as large" if method.map == "clipped" and larger > 1 else ""
    return f"a {method.map} signed distance of {of}{voxels}"
