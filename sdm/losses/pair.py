"""Checks of the two tensors that a loss compares."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.errors import SDMError


def pair(prediction: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Both in the prediction's type, at least float32: sums over a volume do not fit half precision.

    Raises:
        SDMError: The shapes differ, which would otherwise broadcast to a wrong number.
    """
    if prediction.shape != target.shape:
        raise SDMError(
            f"a prediction of shape {tuple(prediction.shape)} and a target of shape {tuple(target.shape)} "
            "cannot be compared: both must have the same"
        )
    if not prediction.is_floating_point():
        raise SDMError(f"a prediction of type {prediction.dtype} has no gradient: give floating-point numbers")
    prediction = at_least_float32(prediction)
    return prediction, target.to(prediction.dtype)


def at_least_float32(values: Tensor) -> Tensor:
    """Half precision widened, everything else as it is."""
    return values.float() if values.dtype in (torch.float16, torch.bfloat16) else values
