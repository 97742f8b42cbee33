from __future__ import annotations

import threading

from sdm.explore.newest_values import NewestValues


def test_the_newest_value_wins():
    box = NewestValues()
    for number in range(100):
        box.put("a", number)
    box.put("b", "x")
    assert box.take() == {"a": 99, "b": "x"}
    assert box.take(timeout=0.01) == {}


def test_the_end_wakes_who_waits():
    box = NewestValues()
    threading.Timer(0.05, box.end).start()
    assert box.take() == {}
    box.put("a", 1)
    assert box.take() == {}
