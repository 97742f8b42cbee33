"""The clamped L1 loss, DeepSDF's."""

from __future__ import annotations

from torch import Tensor

from sdm.core.given_values import real
from sdm.errors import SDMError
from sdm.losses.pair import pair


def clamped_l1_loss(prediction: Tensor, target: Tensor, *, delta: float = 0.1) -> Tensor:
    """mean |clamp(p, delta) - clamp(y, delta)|, clamp(x, delta) = min(delta, max(-delta, x)).

    J. Park et al., "DeepSDF: Learning continuous signed distance functions for shape representation", CVPR 2019,
    with delta = 0.1. A prediction beyond delta on either side has no gradient: start networks near zero.

    Args:
        prediction: Signed distances of any shape.
        target: Signed distances of the same shape.
        delta: Distance from the surface up to which values matter, in their unit.

    Returns:
        A scalar.

    Raises:
        SDMError: A delta that is not positive, or shapes that do not fit together.
    """
    if not real(delta) > 0:
        raise SDMError(f"delta must be positive, not {delta!r}")
    prediction, target = pair(prediction, target)
    return (prediction.clamp(-delta, delta) - target.clamp(-delta, delta)).abs().mean()
