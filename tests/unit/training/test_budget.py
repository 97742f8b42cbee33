from __future__ import annotations

import math

import pytest

from sdm.errors import SDMError
from sdm.surrogate import Settings
from sdm.training.budget import check_budget, share_done


def test_what_is_nearer_its_end_counts():
    assert share_done(30, 100, 9.0, 10.0) == 0.9
    assert share_done(30, 100, 1.0, 10.0) == 0.3
    assert share_done(30, 100, 9.0, None) == 0.3
    assert share_done(30, 100, 99.0, 10.0) == 1.0


@pytest.mark.parametrize("seconds", [0, 0.0, -1.0, math.nan])
def test_a_budget_of_nothing_is_refused(seconds):
    for asked in (check_budget, lambda given: share_done(0, 10, 0.0, given), lambda given: Settings(budget_s=given)):
        with pytest.raises(SDMError, match="seconds trains nothing"):
            asked(seconds)
