from __future__ import annotations

import math

import pytest

from sdm.errors import SDMError
from sdm.training.finite_loss import check_finite


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_loss_that_is_not_finite_ends_a_training(wrong):
    check_finite(3, 1.0, -2.0)
    with pytest.raises(SDMError, match="the loss is not finite at step 1,234: lower the learning rate"):
        check_finite(1234, 1.0, wrong)
