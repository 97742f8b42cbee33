"""Calls that are timed by turns."""

from __future__ import annotations

import time
from functools import partial

from sdm.bench.common.timing import by_turns


def test_each_call_has_its_own_times():
    found = by_turns(
        {"short": partial(time.sleep, 1e-3), "long": partial(time.sleep, 1e-2)}, "cpu", 5, 1e4, warm_ms=1.0
    )
    assert found["short"].runs == found["long"].runs == 5
    assert 1.0 <= found["short"].ms < found["long"].ms
    assert found["long"].ms >= 10.0


def test_turns_end_with_the_budget_but_one_is_there():
    order = []
    calls = {name: partial(lambda name: (order.append(name), time.sleep(5e-3)), name) for name in ("a", "b")}
    found = by_turns(calls, "cpu", 100, 25.0, warm_ms=0.0)
    assert 1 <= found["a"].runs == found["b"].runs <= 3
    assert order[:4] == ["a", "b", "a", "b"][: len(order)]
    assert by_turns(calls, "cpu", 100, 0.0, warm_ms=0.0)["b"].runs == 1
