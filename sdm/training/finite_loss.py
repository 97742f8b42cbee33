"""End of a training whose loss is not finite."""

from __future__ import annotations

import math

from sdm.errors import SDMError


def check_finite(step: int, *values: float) -> None:
    """Refuse to go on with, or to write, weights whose loss or errors are not finite.

    Raises:
        SDMError: Says at which step.
    """
    if not all(math.isfinite(value) for value in values):
        raise SDMError(f"the loss is not finite at step {step:,}: lower the learning rate")
