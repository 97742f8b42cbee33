"""Budgets, clocks and intervals of trainings."""

from __future__ import annotations

import math

import pytest

from sdm.errors import SDMError
from sdm.surrogate import Settings
from sdm.training.budget import Clock, Interval, check_budget, share_done


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


@pytest.fixture
def now(monkeypatch):
    """A clock that stands still until it is set."""
    time = {"s": 100.0}
    monkeypatch.setattr("sdm.training.budget.time.perf_counter", lambda: time["s"])
    return time


def test_the_clock_follows_steps_and_seconds(now):
    assert Clock(10).share(5) == 0.5
    clock = Clock(10, budget_s=10.0, spent_s=3.0)
    now["s"] += 4.0
    assert clock.seconds == 7.0
    assert clock.share(1) == 0.7
    assert clock.share(9) == 0.9


def test_an_interval_begins_anew_when_it_is_over(now):
    pause = Interval(2.0)
    found = []
    for _ in range(5):
        found.append(pause.is_over())
        now["s"] += 1.0
    assert found == [False, False, True, False, True]
    assert all(Interval(0.0).is_over() for _ in range(2))
