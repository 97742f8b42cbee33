"""Clock of a pipeline: how long each stage was busy, and which one the others wait for."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Span:
    """One stage at work on one item.

    Args:
        stage: Its name.
        number: The item, from 0.
        thread: Of the stage's threads, from 0.
        begin: Seconds since the pipeline's start.
        end: The same.
    """

    stage: str
    number: int
    thread: int
    begin: float
    end: float


class StageTimes:
    """Busy times of the stages of one run. Safe to use from their threads.

    Args:
        keep_spans: Keep every span of work, for a picture, and not only sums.
    """

    def __init__(self, *, keep_spans: bool = False) -> None:
        self._lock = threading.Lock()
        self._start = time.perf_counter()
        self._workers: dict[str, int] = {}
        self._busy: dict[str, float] = {}
        self._threads: dict[tuple[str, int], int] = {}
        # Of other processes, by their names: workers and busy seconds of their stages.
        self._others: dict[str, tuple[dict[str, int], dict[str, float]]] = {}
        self._keep = keep_spans
        self.spans: list[Span] = []

    def declare(self, stage: str, workers: int) -> None:
        """A stage, in the order of the pipeline, and how many items it may work on at once."""
        with self._lock:
            self._workers[stage] = workers
            self._busy.setdefault(stage, 0.0)

    @contextmanager
    def busy(self, stage: str, number: int = 0) -> Iterator[None]:
        """The time of the block is counted as work of a stage on an item."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            end = time.perf_counter()
            with self._lock:
                self._busy[stage] = self._busy.get(stage, 0.0) + end - begin
                if self._keep:
                    key = stage, threading.get_ident()
                    thread = self._threads.setdefault(key, sum(known == stage for known, _ in self._threads))
                    self.spans.append(Span(stage, number, thread, begin - self._start, end - self._start))

    def told(self) -> tuple[dict[str, int], dict[str, float]]:
        """Workers and busy seconds of the stages so far, for the clock of another process to `hear`."""
        with self._lock:
            return dict(self._workers), dict(self._busy)

    def hear(self, process: str, told: tuple[dict[str, int], dict[str, float]]) -> None:
        """Take what the clock of another process tells of its stages, in place of what it told before."""
        with self._lock:
            self._others[process] = told

    @property
    def seconds(self) -> dict[str, float]:
        """Busy seconds of each stage, summed over its threads, in the order of the pipeline."""
        with self._lock:
            return _sums([self._busy, *(busy for _, busy in self._others.values())])

    def shares(self) -> dict[str, float]:
        """Share of its capacity that each stage has been busy since the start, 0 to 1."""
        passed, busy = max(time.perf_counter() - self._start, 1e-9), self.seconds
        with self._lock:
            workers = _sums([self._workers, *(own for own, _ in self._others.values())])
        return {stage: busy.get(stage, 0.0) / (count * passed) for stage, count in workers.items()}

    def limit(self) -> str | None:
        """The stage that the others wait for: the busiest of its capacity; None before there was work."""
        shares = self.shares()
        busiest = max(shares, key=lambda stage: shares[stage], default=None)
        return busiest if busiest is not None and shares[busiest] > 0 else None


def _sums(several: Iterable[Mapping[str, float]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for one in several:
        for stage, value in one.items():
            found[stage] = found.get(stage, 0) + value
    return found
