"""Buffer of the stream's latest maps on the device, from which training draws more often than maps are made."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from torch import Tensor

from sdm.core.random import generator
from sdm.errors import SDMError
from sdm.runtime.torch_warp import to_device
from sdm.stream import SDMStream
from sdm.surrogate.networks.cochlea_grid import GRID

HARDNESS = 3.0


class Replay:
    """The latest `capacity` maps of a stream, as float16 on its device (0.4 MB each).

    Args:
        stream: Where maps come from.
        capacity: How many are kept; a new one takes the place of the oldest.
        seed: Of what is drawn.

    float16 keeps a distance below 8 mm within 0.004 mm, and within 0.0002 mm at less than 0.5 mm.
    """

    def __init__(self, stream: SDMStream, capacity: int, seed: int = 0) -> None:
        if capacity < 1:
            raise SDMError(f"a store of {capacity} maps was requested; give at least 1")
        self.stream, self.capacity, self.seed = stream, capacity, seed
        device = stream.device
        self.theta = torch.empty((capacity, 4), device=device)
        self.maps = torch.empty((capacity, 1, *GRID.shape), dtype=torch.float16, device=device)
        # How much of the Dice coefficient each map lost when it was last trained on.
        self.lost = torch.ones(capacity, device=device)
        self.count = self.made = 0
        self._batches = iter(stream)

    def renew(self) -> None:
        """Take the stream's next batch."""
        batch = next(self._batches)
        for begin in range(0, len(batch.theta), self.capacity):
            self._put(batch.theta[begin : begin + self.capacity], batch.sdm[begin : begin + self.capacity])

    def _put(self, theta: Tensor, maps: Tensor) -> None:
        at = self.made % self.capacity
        head = min(len(theta), self.capacity - at)
        for begin, part in ((at, slice(0, head)), (0, slice(head, None))):
            rows = len(theta[part])
            self.theta[begin : begin + rows] = theta[part]
            self.maps[begin : begin + rows] = maps[part]
            self.lost[begin : begin + rows] = self.lost.mean()
        self.made += len(theta)
        self.count = min(self.made, self.capacity)

    def fill(self, seconds: float = float("inf"), progress: Callable[[int], None] | None = None) -> None:
        """Renew until the store is full or the time is over; at least one batch."""
        start = time.perf_counter()
        while self.count < self.capacity and (self.count == 0 or time.perf_counter() - start < seconds):
            self.renew()
            if self.stream.device.type == "cuda" and self.made % (16 * self.stream.batch_size) == 0:
                # The clock must not run ahead of the device.
                torch.cuda.synchronize(self.stream.device)
            if progress is not None:
                progress(self.count)

    def draw(self, count: int, step: int, hard: int = 0) -> Tensor:
        """Rows (count,) of the store, a function of what is stored, seed and step.

        The last `hard` are drawn among the maps that lost much, by the power HARDNESS of what they lost.
        """
        random = generator(self.seed, "surrogate batch", step)
        rows = to_device(torch.randint(self.count, (count,), generator=random), self.theta.device)
        if hard:
            random = generator(self.seed, "hard cases of a surrogate batch", step, device=rows.device)
            weights = self.lost[: self.count] ** HARDNESS
            rows[-hard:] = torch.multinomial(weights, hard, replacement=True, generator=random)
        return rows

    def at(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Parameters (B,4) and maps (B,1,80,64,40) float32 of rows (B,)."""
        return self.theta[rows], self.maps[rows].float()
