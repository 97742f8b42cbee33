"""The soft Dice loss."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.losses.pair import pair, require_number


def dice_loss(
    probability: Tensor, target: Tensor, *, squared: bool = False, per_sample: bool = True, smooth: float = 1e-5
) -> Tensor:
    """1 - (2 sum(p g) + smooth) / (sum(p) + sum(g) + smooth), the mean over samples and channels.

    With `squared` the denominator is sum(p^2) + sum(g^2): F. Milletari et al., "V-Net", 3DV 2016. Without
    `per_sample` the sums run over the whole batch, so that a nearly empty patch cannot dominate.

    Where target and prediction are empty the loss is 0, and where only the target is, nearly 1.

    Args:
        probability: (B,C,x,y,z), 0..1.
        target: (B,C,x,y,z), 0 or 1.
        squared: See above.
        per_sample: Sum over each sample and channel, rather than over all.
        smooth: Keeps the quotient defined.

    Returns:
        A scalar.
    """
    probability, target = pair(probability, target)
    require_number(smooth, "smooth")
    rows = (-1,) if not per_sample else (probability.shape[0] * probability.shape[1], -1)
    probability, target = probability.reshape(rows), target.reshape(rows)
    both = (probability * target).sum(-1)
    sizes = (v.square() if squared else v for v in (probability, target))
    size = sum((v.sum(-1) for v in sizes), torch.zeros_like(both))
    return (1.0 - (2.0 * both + smooth) / (size + smooth)).mean()
