"""How far a training is: by steps and by the clock, over restarts."""

from __future__ import annotations

import math
import time

from sdm.training.budget import share_done


class Clock:
    """The share of a training that is done: of its steps, or of its seconds if that is more.

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
        """0 at the beginning to 1 at the end, before step number `step`."""
        return share_done(step, self.steps, self.seconds, self.budget_s)


def learning_rate(share: float, warmup: float = 0.02, floor: float = 0.005) -> float:
    """Factor of the learning rate: a linear rise over `warmup`, then half a cosine down to `floor`."""
    if share < warmup:
        return max(share / warmup, floor)
    wave = 0.5 * (1 + math.cos(math.pi * (share - warmup) / (1 - warmup)))
    return floor + (1 - floor) * wave
