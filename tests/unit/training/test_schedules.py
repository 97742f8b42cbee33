"""Schedules of learning rates and of weights of losses."""

from __future__ import annotations

import math

import pytest

from sdm.errors import SDMError
from sdm.training.schedules import (
    constant,
    cosine_decay,
    linear,
    linear_warmup,
    sigmoid_rampup,
    stepwise,
    warmup_cosine,
)


def test_a_cosine_falls_to_its_floor():
    assert [cosine_decay(d, 4.0) for d in (0, 1, 2, 4)] == pytest.approx([1, (1 + math.sqrt(0.5)) / 2, 0.5, 0])
    assert [cosine_decay(d, floor=0.2) for d in (0.0, 0.5, 1.0)] == pytest.approx([1, 0.6, 0.2])


def test_a_warm_up_rises_and_stays():
    assert [linear_warmup(d, 4) for d in (0, 1, 4, 9)] == [0, 0.25, 1, 1]
    assert linear_warmup(0.0, 0.0) == 1


def test_a_warm_up_comes_before_the_cosine():
    assert [warmup_cosine(s, 0.1, 0.2) for s in (0.0, 0.05, 0.1, 0.55, 1.0)] == pytest.approx([0.2, 0.5, 1, 0.6, 0.2])


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
