"""Time of trainings: budgets of steps and seconds, whichever ends first, and clocks that go on after a restart."""

from __future__ import annotations

import time

from sdm.core.given_values import real
from sdm.errors import SDMError


def share_done(step: int, steps: int, seconds: float, budget_s: float | None) -> float:
    """Share of a training that is done, 0 to 1: of its steps or of its seconds, whichever is nearer its end.

    Raises:
        SDMError: As `check_budget`.
    """
    check_budget(budget_s)
    by_clock = 0.0 if budget_s is None else seconds / budget_s
    return min(1.0, max(step / steps, by_clock))


def check_budget(budget_s: float | None) -> None:
    """Refuse a budget in which nothing can be trained.

    Raises:
        SDMError: It is neither positive nor None.
    """
    if budget_s is not None and not real(budget_s) > 0:
        raise SDMError(f"a budget of {real(budget_s):g} seconds trains nothing: give a positive number, or none")


class Clock:
    """Seconds of a training over all its restarts, and the share of it that is done.

    Args:
        steps: Steps of the whole training.
        budget_s: Seconds of the whole training, over all restarts; None for as long as it takes.
        spent_s: Seconds that earlier runs took.
    """

    def __init__(self, steps: int, budget_s: float | None = None, spent_s: float = 0.0) -> None:
        self.steps, self.budget_s, self._spent = steps, budget_s, spent_s
        self._start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Seconds so far, those of earlier runs among them."""
        return self._spent + time.perf_counter() - self._start

    def share(self, step: int) -> float:
        """Share done, 0 at the beginning to 1 at the end, before step number `step`."""
        return share_done(step, self.steps, self.seconds, self.budget_s)


class Interval:
    """Moments that are some seconds apart, such as those of checkpoints."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._last = seconds, time.perf_counter()

    def is_over(self) -> bool:
        """True once the seconds have passed, counted anew from then on."""
        now = time.perf_counter()
        if now - self._last < self._seconds:
            return False
        self._last = now
        return True
