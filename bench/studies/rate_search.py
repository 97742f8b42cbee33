"""Learning rate by validation: the best of a grid, once other processes have tried all of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping


def best_rate(
    tried: Callable[[], Mapping[float, float]], rates: Iterable[float], deadline: float, *, every_s: float = 0.5
) -> float | None:
    """The rate with the least validation error.

    Args:
        tried: Gives the errors of the rates that are tried by now.
        rates: The grid; it waits until all of it is tried.
        deadline: Value of `time.monotonic()` at which to give up.
        every_s: Seconds between looks.

    Returns:
        The rate; of equal ones the first of the grid. None where the deadline came first.
    """
    grid = list(rates)
    while True:
        found = tried()
        if all(rate in found for rate in grid):
            return min(grid, key=found.__getitem__)
        if time.monotonic() > deadline:
            return None
        time.sleep(every_s)
