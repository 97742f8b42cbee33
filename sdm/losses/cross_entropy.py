"""Cross-entropy."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from sdm.errors import SDMError
from sdm.losses.pair import at_least_float32, pair, require_tensors


def cross_entropy_loss(logits: Tensor, target: Tensor, *, weight: Tensor | None = None) -> Tensor:
    """mean of -log(probability of the voxel's class), from logits, so that none is ever log(0).

    Args:
        logits: (B,1,x,y,z) of the foreground (the probability is their sigmoid), or (B,C,x,y,z) of C > 1 classes
            (softmax).
        target: (B,1,x,y,z): 0 or 1, or the class's number.
        weight: (2,) or (C,) weights of the classes, background first; the mean is weighted.

    Returns:
        A scalar.

    Raises:
        SDMError: Shapes that do not fit together, or not a weight for each class.
    """
    require_tensors(logits, target, *([] if weight is None else [weight]))
    if logits.ndim < 2:
        raise SDMError(f"logits of shape {tuple(logits.shape)} have no channels: give (B,C,x,y,z)")
    classes = max(2, logits.shape[1])
    if weight is not None and weight.shape != (classes,):
        raise SDMError(f"weights of shape {tuple(weight.shape)} do not fit {classes} classes")
    if logits.shape[1] == 1:
        logits, target = pair(logits, target)
        each = functional.binary_cross_entropy_with_logits(logits, target, reduction="none")
        if weight is None:
            return each.mean()
        share = torch.lerp(weight[0].to(each), weight[1].to(each), target)
        return (each * share).sum() / share.sum()
    if target.shape != (logits.shape[0], 1, *logits.shape[2:]):
        raise SDMError(
            f"a target of shape {tuple(target.shape)} does not fit logits of shape {tuple(logits.shape)}: "
            "give the number of the class with one channel"
        )
    logits = at_least_float32(logits)
    return functional.cross_entropy(logits, target[:, 0].long(), None if weight is None else weight.to(logits))
