"""What the benchmark of the stream measures, and how large: small on a CPU, where it only shows that it runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import torch

from bench._timing import once
from sdm import Grid
from sdm.shapes import Cochlea
from sdm.stream import Batch, SDMStream

# Steps of one measurement, and how often streamed and cached steps take turns.
STEPS, TURNS = 60, 5


class Bench:
    """Sizes of the benchmark on a device."""

    def __init__(self, device: str) -> None:
        self.device = device
        self.gpu = device.startswith("cuda")
        self.family = Cochlea(20_000 if self.gpu else 1_000)
        self.resolution = 64 if self.gpu else 16
        self.grid: Grid = self.family.grid(self.resolution)
        self.batch = 16 if self.gpu else 2
        self.steps, self.turns = (STEPS, TURNS) if self.gpu else (3, 1)

    def stream(self, batch: int, **options: Any) -> SDMStream:
        return SDMStream(self.family, self.grid, batch, device=self.device, **options)

    def wait(self) -> None:
        if self.gpu:
            torch.cuda.synchronize()

    def rate(self, batches: Iterator[Batch], size: int, steps: int) -> float:
        """Samples a second, after a few that do not count."""
        for _ in range(min(5, steps)):
            next(batches)
        self.wait()
        start = time.perf_counter()
        for _ in range(steps):
            next(batches)
        self.wait()
        return steps * size / (time.perf_counter() - start)

    def speed(self, call: Callable[[], None]) -> float:
        """Calls a second."""
        ms, _ = once(lambda: [call() for _ in range(self.steps)], self.device)
        return 1e3 * self.steps / ms
