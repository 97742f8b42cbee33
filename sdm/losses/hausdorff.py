"""The Hausdorff distance loss by distance transforms."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.losses.pair import pair, require_number, require_tensors
from sdm.losses.targets import Spacing, foreground_distance


def hausdorff_distance_loss(
    probability: Tensor,
    target: Tensor,
    spacing: Spacing = 1.0,
    *,
    foreground_only: bool = False,
    power: float = 2.0,
    threshold: float = 0.5,
) -> Tensor:
    """mean((p - g)^2 * (d_s^power + d_g^power)), s = [p > threshold].

    D. Karimi, S. Salcudean, "Reducing the Hausdorff distance in medical image segmentation with convolutional neural
    networks", IEEE TMI 2020. d is the distance from the mask's boundary on both sides of it: of a voxel
    outside from the nearest voxel inside, and of one inside from the nearest outside. Ma's published code transforms
    the foreground alone (`foreground_only`): a false positive then costs by the prediction's own depth there, not by
    how far it is from the target.

    A mask that is empty or full has no boundary and adds nothing: d = 0. Where both are, the loss is 0; add Dice.
    No gradient flows through the transforms.

    Args:
        probability: (B,1,x,y,z) of the foreground, 0..1.
        target: (B,1,x,y,z), foreground not zero.
        spacing: Size of a voxel along each axis; the loss is in its unit to the power.
        foreground_only: See above.
        power: The exponent, alpha in the paper.
        threshold: Above it a voxel counts as foreground.

    Returns:
        A scalar.
    """
    require_tensors(probability, target)
    require_number(power, "the power")
    require_number(threshold, "the threshold")
    inside = target != 0
    probability, target = pair(probability, inside)
    with torch.no_grad():
        weight = torch.zeros_like(probability)
        for mask in (probability > threshold, inside):
            if foreground_only:
                distance = foreground_distance(mask, spacing)
            else:
                distance = euclidean_distance_transform(mask, spacing, signed=True, missing=0.0).abs()
            weight += distance.to(weight.dtype) ** power
    return ((probability - target).square() * weight).mean()
