"""Two masks of one case, checked."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor

from sdm.errors import SDMError

# A mask as the metrics take it.
Mask: TypeAlias = Tensor | np.ndarray


def masks(prediction: Mask, truth: Mask) -> tuple[Tensor, Tensor]:
    """Both as bool (x,y,z), NumPy's arrays on the host; (1,x,y,z) and (1,1,x,y,z) lose their ones.

    Raises:
        SDMError: The shapes differ, are not one volume, or the prediction is not a decision.
    """
    prediction, truth = _tensor(prediction, "prediction"), _tensor(truth, "truth")
    if prediction.shape != truth.shape:
        raise SDMError(
            f"a prediction of shape {tuple(prediction.shape)} and a truth of shape {tuple(truth.shape)} "
            "cannot be compared: both must be on the same grid"
        )
    shape = tuple(prediction.shape)
    if not 3 <= len(shape) <= 5 or any(n != 1 for n in shape[:-3]) or 0 in shape:
        raise SDMError(f"masks of shape {shape} are not one volume: give the cases one by one as (x,y,z)")
    return _mask(prediction, "prediction").reshape(shape[-3:]), _mask(truth, "truth").reshape(shape[-3:])


def _tensor(values: Mask, what: str) -> Tensor:
    if isinstance(values, Tensor):
        return values
    array = np.asarray(values)
    if array.dtype.kind not in "buif":
        raise SDMError(f"the {what} holds {array.dtype} values: give a tensor or a NumPy array of a mask")
    # A copy, as torch holds no views with negative strides.
    return torch.from_numpy(np.array(array, np.float64) if array.dtype.kind == "f" else np.asarray(array != 0))


def _mask(values: Tensor, what: str) -> Tensor:
    if values.dtype == torch.bool:
        return values
    if values.is_floating_point() and not ((values == 0) | (values == 1)).all():
        raise SDMError(f"the {what} is not a mask: threshold its probabilities first")
    return values != 0
