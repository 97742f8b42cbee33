from __future__ import annotations

import threading
import time
import weakref

import pytest

from sdm.runtime.pipeline.outcome import Done, Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import MOST_BYTES, in_groups, in_threads, numbered, one_by_one


def pipeline(items, workers, *, most=3, work=lambda x: x * x):
    times = StageTimes(keep_spans=True)
    read = in_threads(numbered(items), "read", lambda x: x, workers=workers, times=times)
    made = in_groups(read, "device", lambda group: [work(x) for x in group], times=times, most=most)
    return times, in_threads(made, "write", lambda x: x + 1, workers=workers, times=times, prompt=True)


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("most", [1, 3])
def test_results_come_in_the_order_of_the_items(workers, most):
    times, results = pipeline(range(20), workers, most=most)
    assert [found.value for found in results] == [x * x + 1 for x in range(20)]
    assert sum(span.stage == "write" for span in times.spans) == 20
    assert list(times.seconds) == ["read", "device", "write"]
    assert {span.thread for span in times.spans} <= set(range(workers))


def test_slow_items_do_not_change_the_order():
    def slow_first(x):
        time.sleep(0.02 if x == 0 else 0)
        return x

    found = in_threads(numbered(range(8)), "s", slow_first, workers=4, times=StageTimes())
    assert [outcome.value for outcome in found] == list(range(8))


def test_one_bad_item_fails_alone():
    def work(x):
        if x == 4:
            raise ValueError("four")
        return x

    for most in (1, 3):
        _, results = pipeline(range(7), 2, most=most, work=work)
        found = list(results)
        assert [outcome.number for outcome in found] == list(range(7))
        (failed,) = (outcome for outcome in found if isinstance(outcome, Failed))
        assert (failed.number, str(failed.error)) == (4, "four")
        assert [outcome.value for outcome in found if isinstance(outcome, Done)] == [1, 2, 3, 4, 6, 7]


def test_no_more_is_taken_than_there_is_room_for():
    taken = []

    def items():
        for x in range(50):
            taken.append(x)
            yield x

    results = in_threads(numbered(items()), "s", lambda x: x, workers=2, times=StageTimes(), most_held=4)
    next(results)
    assert len(taken) <= 4
    results.close()


def test_the_next_items_are_worked_on_while_the_caller_has_one():
    begun = [threading.Event() for _ in range(12)]

    def work(x):
        begun[x].set()
        return x

    results = in_threads(numbered(range(12)), "s", work, workers=1, times=StageTimes(), most_held=2)
    for outcome in results:
        # Without asking for more.
        if outcome.number + 1 < len(begun):
            assert begun[outcome.number + 1].wait(5)


def test_what_is_done_is_given_on_before_a_slow_source_is_asked():
    asked = []

    def slow():
        for x in range(4):
            asked.append(x)
            yield x
            time.sleep(0.05)

    results = in_threads(numbered(slow()), "s", lambda x: x, workers=1, times=StageTimes(), most_held=3, prompt=True)
    next(results)
    assert len(asked) <= 2
    results.close()


def test_memory_is_a_limit_too():
    at_once, most, lock = 0, 0, threading.Lock()

    def work(x):
        nonlocal at_once, most
        with lock:
            at_once += 1
            most = max(most, at_once)
        time.sleep(0.002)
        with lock:
            at_once -= 1

    half = MOST_BYTES // 2
    results = in_threads(numbered(range(9)), "s", work, workers=4, times=StageTimes(), nbytes=lambda _: half)
    assert len(list(results)) == 9
    assert most <= 2


def test_an_interrupt_leaves_no_thread():
    before = threading.active_count()
    _, results = pipeline(range(100), 3)
    next(results)
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt)
    assert threading.active_count() == before


def test_an_interrupt_in_the_callers_stage_ends_all():
    def work(x):
        if x == 5:
            raise KeyboardInterrupt
        return x

    times = StageTimes()
    read = in_threads(numbered(range(100)), "read", lambda x: x, workers=2, times=times)
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        list(in_threads(one_by_one(read, "device", work, times=times), "write", str, workers=2, times=times))
    del read
    assert threading.active_count() <= before


def test_values_are_let_go():
    class Thing:
        pass

    alive = weakref.WeakSet()

    def make(_):
        thing = Thing()
        alive.add(thing)
        return thing

    times = StageTimes()
    made = one_by_one(numbered(range(40)), "make", make, times=times)
    for outcome in in_threads(made, "write", lambda thing: None, workers=2, times=times):
        assert isinstance(outcome, Done)
        assert len(alive) <= 6


def test_the_busiest_stage_limits():
    times = StageTimes()
    assert times.limit() is None
    results = in_threads(numbered(range(6)), "quick", lambda x: x, workers=2, times=times)
    for _ in one_by_one(results, "slow", lambda x: time.sleep(0.01), times=times):
        pass
    assert times.limit() == "slow"
    assert times.seconds["slow"] >= 0.06
    assert 0 < times.shares()["slow"] <= 1


def test_clocks_of_other_processes_count():
    own, others = StageTimes(), [StageTimes(), StageTimes()]
    own.declare("write", 2)
    for number, other in enumerate(others):
        other.declare("read", 1)
        with other.busy("read"):
            time.sleep(0.02)
        # Told twice, it counts once.
        own.hear(f"{number}", other.told())
        own.hear(f"{number}", other.told())
    assert own.seconds["read"] == pytest.approx(sum(other.seconds["read"] for other in others))
    assert list(own.shares()) == ["write", "read"]
    assert 0 < own.shares()["read"] <= 1
    assert own.limit() == "read"
