"""The product loss between signed distance maps."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.losses.pair import at_least_float32, pair, require_number, require_tensors


def sdf_product_loss(
    prediction: Tensor, target: Tensor, *, per_voxel: bool = False, l1_weight: float = 1.0, smooth: float = 1e-5
) -> Tensor:
    """-(<y,p> + smooth) / (<y,p> + <p,p> + <y,y> + smooth) + l1_weight * mean |y - p|.

    Y. Xue et al., "Shape-aware organ segmentation by predicting signed distance maps", AAAI 2020; the AAAI row of
    Ma et al., MIDL 2020, whose code weighs the whole by 10 beside Dice of `probability_from_sdf`. The quotient is of
    sums over the batch or, with `per_voxel`, taken at each voxel and averaged. It is between -1/3, where both agree,
    and 1, where they are opposite. Where both are zero, `smooth` makes it -1 rather than undefined; the gradient there
    is 0.

    Args:
        prediction: (B,1,x,y,z) signed distances, usually through tanh.
        target: (B,1,x,y,z) signed distances in -1..1, see `normalized_signed_distance`.
        per_voxel: See above; the gradient of a voxel then does not depend on the others.
        l1_weight: Weight of the mean absolute difference.
        smooth: Keeps the quotient defined.

    Returns:
        A scalar.
    """
    prediction, target = pair(prediction, target)
    product, squares = prediction * target, prediction.square() + target.square()
    if not per_voxel:
        product, squares = product.sum(), squares.sum()
    quotient = (product + smooth) / (product + squares + smooth)
    return l1_weight * (prediction - target).abs().mean() - quotient.mean()


def probability_from_sdf(distance: Tensor, steepness: float = 1500.0) -> Tensor:
    """sigmoid(-steepness * phi): a smooth step that is 1 inside, so that Dice can be taken of a distance map.

    Xue et al., AAAI 2020, with phi in -1..1. The gradient is lost further than some 20 / steepness from the surface.

    Args:
        distance: Signed distances of any shape, negative inside.
        steepness: Inverse width of the step, in 1 / unit of the distances.

    Returns:
        Probabilities of the same shape.
    """
    require_tensors(distance)
    require_number(steepness, "the steepness")
    return torch.sigmoid(-steepness * at_least_float32(distance))
