"""Sizes of the stream's benchmark: small on a CPU, where it only shows that it runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import torch
import torch.distributed as dist

from sdm import Grid
from sdm.shapes import Cochlea
from sdm.stream import Batch, SDMStream

# Calls that are not counted, and the fewest that are; the part of a measurement's time that tells how many it takes.
WARM, FEWEST, SHARE = 5, 3, 0.1


class Bench:
    """Sizes of the benchmark on a device, and the clock.

    Args:
        device: Where the stream computes.
        deadline: `time.monotonic()` at which the whole benchmark has to be through; None for never.
    """

    def __init__(self, device: str, deadline: float | None = None) -> None:
        self.device = device
        self.gpu = device.startswith("cuda")
        self._deadline = deadline
        self.family = Cochlea(20_000 if self.gpu else 1_000)
        self.resolution = 64 if self.gpu else 16
        self.grid: Grid = self.family.grid(self.resolution)
        self.batch = 16 if self.gpu else 2
        # Seconds of one measurement, and how often it is repeated.
        self.seconds, self.turns = (1.0, 5) if self.gpu else (0.2, 2)

    @property
    def left(self) -> float:
        """Seconds until the deadline."""
        return float("inf") if self._deadline is None else self._deadline - time.monotonic()

    def stream(self, batch: int, **options: Any) -> SDMStream:
        return SDMStream(self.family, self.grid, batch, device=self.device, **options)

    def wait(self) -> None:
        if self.gpu:
            torch.cuda.synchronize()

    def rate(self, batches: Iterator[Batch], size: int) -> float:
        """Samples a second."""
        return size * self.speed(lambda: next(batches))

    def calls(self, call: Callable[[], object], *, shared: bool = False) -> int:
        """Number of calls of one measurement; `shared`: rank 0 decides, or ranks would wait for each other."""
        for _ in range(WARM):
            call()
        count = FEWEST
        while True:
            took = count / self.speed(call, count)
            if shared:
                said = torch.tensor(took, dtype=torch.float64, device=self.device)
                dist.broadcast(said, 0)
                took = float(said)
            if took >= SHARE * self.seconds:
                return max(FEWEST, round(self.seconds * count / took))
            # A stream makes several batches at once: a few of them may have been there already.
            count *= 4

    def speed(self, call: Callable[[], object], count: int | None = None) -> float:
        """Calls a second, by the clock on the wall, the device waited for at both ends."""
        count = self.calls(call) if count is None else count
        self.wait()
        start = time.perf_counter()
        for _ in range(count):
            call()
        self.wait()
        return count / (time.perf_counter() - start)
