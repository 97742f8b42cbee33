"""Squared error that counts most near the surface."""

from __future__ import annotations

from torch import Tensor

from sdm.core.given_values import real
from sdm.errors import SDMError
from sdm.losses.pair import pair, require_tensors


def inverse_weighted_mse_loss(prediction: Tensor, target: Tensor, *, epsilon: float = 1e-3) -> Tensor:
    """mean((p - y)^2 / (|y| + epsilon)).

    K. Juhl et al., "Guiding 3D U-nets with signed distance fields for creating 3D models from images", MIDL 2019.
    Formula and epsilon = 0.001 are those of the authors' later public code; so a voxel on the surface weighs 1001
    times one at the clipping distance.

    Args:
        prediction: (B,1,x,y,z) signed distances.
        target: (B,1,x,y,z) signed distances, clipped and scaled to -1..1 by `clipped_sdf`.
        epsilon: Weight on the surface is 1 / epsilon; positive.

    Returns:
        A scalar.

    Raises:
        SDMError: An epsilon that is not positive, or shapes that do not fit together.
    """
    if not real(epsilon) > 0:
        raise SDMError(f"epsilon must be positive, not {epsilon!r}: on the surface the weight is 1 / epsilon")
    prediction, target = pair(prediction, target)
    return ((prediction - target).square() / (target.abs() + epsilon)).mean()


def clipped_sdf(distance: Tensor, limit: float = 5.0) -> Tensor:
    """clip(phi, -limit, limit) / limit: Juhl's regression target, in -1..1.

    Args:
        distance: Signed distances of any shape. Infinite ones are clipped like any other.
        limit: Clipping distance in the distances' unit; Juhl's is 5.

    Raises:
        SDMError: A limit that is not positive.
    """
    require_tensors(distance)
    if not real(limit) > 0:
        raise SDMError(f"the clipping distance must be positive, not {limit!r}")
    return distance.clamp(-limit, limit) / limit
