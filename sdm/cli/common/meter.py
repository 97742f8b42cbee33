"""How far a long work is: rate and time left on stderr, as a bar on a terminal and as a line now and then in a log."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self

# Seconds between the lines in a log.
EVERY = 30.0


class Meter:
    """Call it with how many are done and how many there are.

    Args:
        what: What is counted.

    What is there at the first call does not count for the rate.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._start: tuple[float, int] | None = None
        self._said = 0.0
        self._drawn = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._drawn:
            print(file=sys.stderr)

    def __call__(self, done: int, total: int) -> None:
        """`done` of `total`."""
        now = time.monotonic()
        if self._start is None:
            self._start, self._said = (now, done), now
            return
        line = f"{done:,} of {total:,} {self._what}{_pace(done - self._start[1], total - done, now - self._start[0])}"
        if sys.stderr.isatty():
            share = done * 20 // max(total, 1)
            print(f"\r\x1b[K{'#' * share}{'.' * (20 - share)} {line}", end="", file=sys.stderr, flush=True)
            self._drawn = True
        elif now - self._said >= EVERY:
            print(f"sdm: {line}", file=sys.stderr, flush=True)
            self._said = now


def _pace(made: int, left: int, seconds: float) -> str:
    if made <= 0 or seconds <= 0:
        return ""
    rate = made / seconds
    minutes, rest = divmod(int(left / rate), 60)
    hours, minutes = divmod(minutes, 60)
    return f", {rate:,.3g} a second, {hours}:{minutes:02}:{rest:02} left"
