from __future__ import annotations

import math

import pytest

from sdm.errors import SDMError
from sdm.losses import constant, linear, sigmoid_rampup, stepwise


def test_constant():
    assert [constant(0.3)(step) for step in (0, 1e9)] == [0.3, 0.3]


def test_linear():
    weight = linear(1.0, 0.2, 100)
    assert [weight(s) for s in (-1, 0, 50, 100, 1000)] == pytest.approx([1, 1, 0.6, 0.2, 0.2])


def test_rebalancing_of_the_boundary_loss():
    """Region weight 1, 0.99, ... 0.01, an epoch of 4 steps each."""
    weight = stepwise(1.0, -0.01, 4, 0.01)
    assert [weight(s) for s in (0, 3, 4, 7, 8, 4 * 98, 4 * 99, 10_000)] == pytest.approx(
        [1, 1, 0.99, 0.99, 0.98, 0.02, 0.01, 0.01]
    )
    assert [stepwise(0.0, 0.5, 1, 1.0)(s) for s in range(4)] == [0, 0.5, 1, 1]


def test_rampup():
    weight = sigmoid_rampup(0.1, 40)
    assert [weight(s) for s in (0, 20, 40, 80)] == pytest.approx([0.1 * math.exp(-5), 0.1 * math.exp(-1.25), 0.1, 0.1])


def test_what_never_ends_is_refused():
    for make in (lambda: linear(0, 1, 0), lambda: sigmoid_rampup(1, -1), lambda: stepwise(1, -0.1, 0, 0)):
        with pytest.raises(SDMError, match="steps"):
            make()
    for change in (0.0, 0.1):
        with pytest.raises(SDMError, match="never"):
            stepwise(1.0, change, 1, 0.0)
