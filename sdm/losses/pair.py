"""Checks of the two tensors that a loss compares."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sdm.core.given_values import real
from sdm.errors import SDMError


def pair(prediction: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Both in the prediction's type, at least float32: sums over a volume do not fit half precision.

    Raises:
        SDMError: One is no tensor, or the shapes differ, which would otherwise broadcast to a wrong number.
    """
    require_tensors(prediction, target)
    if prediction.shape != target.shape:
        raise SDMError(
            f"a prediction of shape {tuple(prediction.shape)} and a target of shape {tuple(target.shape)} "
            "cannot be compared: both must have the same"
        )
    if not prediction.is_floating_point():
        raise SDMError(f"a prediction of type {prediction.dtype} has no gradient: give floating-point numbers")
    prediction = at_least_float32(prediction)
    return prediction, target.to(prediction.dtype)


def require_tensors(*given: object) -> None:
    """Refuse what is no tensor.

    Raises:
        SDMError: Something is none.
    """
    for value in given:
        if not isinstance(value, Tensor):
            raise SDMError(f"an object of type {type(value).__name__} is no tensor: losses are of torch's tensors")


def require_number(value: object, what: str) -> None:
    """Refuse what is no number, and NaN; a tensor is not looked at, as a GPU would be waited for.

    Raises:
        SDMError: It is none.
    """
    if not isinstance(value, Tensor) and math.isnan(real(value)):
        raise SDMError(f"{what} is {value!r}; give a number")


def at_least_float32(values: Tensor) -> Tensor:
    """Half precision widened, everything else as it is."""
    return values.float() if values.dtype in (torch.float16, torch.bfloat16) else values
