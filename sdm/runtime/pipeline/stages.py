"""Stages of a pipeline: in threads ahead of who asks, or in the caller's own thread, item by item or in groups.

A pipeline is generators one around the other: `in_threads(one_by_one(in_threads(items, read), measure), write)`. Who
goes through the last one drives all: threads read ahead and write behind, the work in the middle stays in the caller's
thread, where CUDA streams, interrupts and memory limits are what they are without a pipeline. Every stage holds a
bounded number of items, and gives them on in their order, so nothing depends on the number of threads. An item that a
stage cannot do is passed on as `Failed`, and the others go on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from typing import TypeVar

from sdm.kernels.launch import by_this_thread
from sdm.runtime.pipeline.outcome import Done, Failed
from sdm.runtime.pipeline.stage_times import StageTimes

A = TypeVar("A")
B = TypeVar("B")
# What a stage holds may take no more memory than this, but for a single item.
MOST_BYTES = 1 << 31


def numbered(items: Iterable[A]) -> Iterator[Done[A]]:
    """The items of a pipeline, each with its number from 0."""
    return (Done(number, item) for number, item in enumerate(items))


def in_threads(
    outcomes: Iterable[Done[A] | Failed],
    name: str,
    work: Callable[[A], B],
    *,
    workers: int,
    times: StageTimes,
    most_held: int | None = None,
    nbytes: Callable[[A], int] | None = None,
    prompt: bool = False,
    single: bool = False,
) -> Generator[Done[B] | Failed, None, None]:
    """A stage in threads of its own; results in the order of the items.

    Args:
        outcomes: Of the stage before; they are asked for as there is room.
        name: Of the stage, for `times`.
        work: What is done to each value. It may run in any thread, and several at once.
        workers: Number of threads.
        times: Where busy times go.
        most_held: Items that the stage holds at most; twice the threads by default.
        nbytes: Memory that an item takes here; all together at most `MOST_BYTES`.
        prompt: Give on what is done before more is taken: for the last stage, behind one that works in the caller's
            thread. Otherwise as much is taken as there is room for, and worked on while the caller has something.
        single: There is one item, whose kernels on a CPU may have all threads. Of several each thread runs its own.

    When the generator is closed, by an error or an interrupt of who goes through it, work that has not begun is
    dropped, and work that has is waited for.
    """
    # Here, and not when the first result is asked for, so that stages are known in the order of the pipeline.
    times.declare(name, workers)
    room = 2 * workers if most_held is None else most_held
    return _in_threads(outcomes, name, work, workers, times, room, nbytes, prompt, single)


def _in_threads(
    outcomes: Iterable[Done[A] | Failed],
    name: str,
    work: Callable[[A], B],
    workers: int,
    times: StageTimes,
    room: int,
    nbytes: Callable[[A], int] | None,
    prompt: bool,
    single: bool,
) -> Generator[Done[B] | Failed, None, None]:
    held: deque[tuple[int, Future[B] | Failed, int]] = deque()
    used, source, more = 0, iter(outcomes), True

    def timed(number: int, value: A) -> B:
        with times.busy(name, number), nullcontext() if single else by_this_thread():
            return work(value)

    pool = ThreadPoolExecutor(workers, thread_name_prefix=f"sdm-{name}")
    try:
        while more or held:
            while held and (not more or len(held) >= room or (prompt and _is_there(held[0][1]))):
                used -= held[0][2]
                yield _outcome(*held.popleft()[:2])
                if not prompt:
                    break
            if not more:
                continue
            found = next(source, None)
            if found is None:
                more = False
                continue
            size = nbytes(found.value) if nbytes is not None and isinstance(found, Done) else 0
            while held and used + size > MOST_BYTES:
                used -= held[0][2]
                yield _outcome(*held.popleft()[:2])
            used += size
            waiting = found if isinstance(found, Failed) else pool.submit(timed, found.number, found.value)
            held.append((found.number, waiting, size))
            # The item itself is the thread's now.
            del found, waiting
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def one_by_one(
    outcomes: Iterable[Done[A] | Failed], name: str, work: Callable[[A], B], *, times: StageTimes
) -> Iterator[Done[B] | Failed]:
    """A stage in the caller's thread."""
    return in_groups(outcomes, name, lambda values: [work(value) for value in values], times=times, most=1)


def in_groups(
    outcomes: Iterable[Done[A] | Failed],
    name: str,
    work: Callable[[Sequence[A]], Sequence[B]],
    *,
    times: StageTimes,
    most: int,
) -> Iterator[Done[B] | Failed]:
    """A stage in the caller's thread that takes up to `most` items at once.

    Where a group fails, its items are done one by one, so that only the one that is at fault fails.
    """
    times.declare(name, 1)
    return _in_groups(outcomes, name, work, times, most)


def _in_groups(
    outcomes: Iterable[Done[A] | Failed],
    name: str,
    work: Callable[[Sequence[A]], Sequence[B]],
    times: StageTimes,
    most: int,
) -> Iterator[Done[B] | Failed]:
    group: list[Done[A] | Failed] = []
    for outcome in outcomes:
        group.append(outcome)
        if len(group) >= most:
            yield from _of_group(group, name, work, times)
            group = []
        del outcome
    yield from _of_group(group, name, work, times)


def _of_group(
    group: Sequence[Done[A] | Failed], name: str, work: Callable[[Sequence[A]], Sequence[B]], times: StageTimes
) -> Iterator[Done[B] | Failed]:
    good = [outcome for outcome in group if isinstance(outcome, Done)]
    made: dict[int, Done[B] | Failed] = {outcome.number: outcome for outcome in group if isinstance(outcome, Failed)}
    if good:
        made.update((outcome.number, outcome) for outcome in _worked(good, name, work, times))
    numbers = [outcome.number for outcome in group]
    for number in numbers:
        yield made.pop(number)


def _worked(
    good: Sequence[Done[A]], name: str, work: Callable[[Sequence[A]], Sequence[B]], times: StageTimes
) -> list[Done[B] | Failed]:
    """The outcomes of work on some values together; one by one if that fails, so that each has its own."""
    try:
        with times.busy(name, good[0].number):
            values = work([outcome.value for outcome in good])
    # Whoever looks at the outcome raises it, or says it.
    except Exception as error:  # noqa: BLE001
        if len(good) == 1:
            return [Failed(good[0].number, error)]
        return [found for outcome in good for found in _worked([outcome], name, work, times)]
    return [Done(outcome.number, value) for outcome, value in zip(good, values, strict=True)]


def _is_there(waiting: Future[B] | Failed) -> bool:
    return isinstance(waiting, Failed) or waiting.done()


def _outcome(number: int, waiting: Future[B] | Failed) -> Done[B] | Failed:
    if isinstance(waiting, Failed):
        return waiting
    error = waiting.exception()
    if error is None:
        return Done(number, waiting.result())
    if isinstance(error, Exception):
        return Failed(number, error)
    raise error
