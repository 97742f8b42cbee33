"""Clock of a pipeline: how long each stage was busy, and which one the others wait for."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
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

    @property
    def seconds(self) -> dict[str, float]:
        """Busy seconds of each stage, summed over its threads, in the order of the pipeline."""
        with self._lock:
            return dict(self._busy)

    def shares(self) -> dict[str, float]:
        """Share of its capacity that each stage has been busy since the start, 0 to 1."""
        passed = max(time.perf_counter() - self._start, 1e-9)
        with self._lock:
            return {stage: self._busy[stage] / (workers * passed) for stage, workers in self._workers.items()}

    def limit(self) -> str | None:
        """The stage that the others wait for: the busiest of its capacity; None before there was work."""
        shares = self.shares()
        busiest = max(shares, key=lambda stage: shares[stage], default=None)
        return busiest if busiest is not None and shares[busiest] > 0 else None
