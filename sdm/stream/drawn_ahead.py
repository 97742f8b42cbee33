"""Parameters of a stream's next steps, drawn for many steps by one call.

On the host a draw takes as long as its call: 1,024 samples take four times as long as 64 (`sdm.stream.samplers`), and
what a GPU's host has no time for is the stream's limit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

# Samples of one draw.
AT_ONCE = 1024


class DrawnAhead:
    """Numbers and parameters of steps that follow each other.

    Args:
        theta: Parameters (B,P) float32 on the host for global numbers (B,) int64 on the host: pure, by number.
        batch_size: Samples of a step.
        offset: From a step to the number of its first sample.
        stride: From a step to the next.
        stop: All steps are before it; None: there is no end.
    """

    def __init__(
        self, theta: Callable[[Tensor], Tensor], batch_size: int, offset: int, stride: int, stop: int | None
    ) -> None:
        self._theta, self._offset, self._stride, self._stop = theta, offset, stride, stop
        self._within = torch.arange(batch_size, device="cpu")
        # The steps drawn and not yet given begin there.
        self._begin, self._numbers = 0, self._within[:0].view(0, batch_size)
        self._drawn = torch.empty(0, batch_size, 0, device="cpu")

    def take(self, steps: Sequence[int]) -> tuple[Tensor, Tensor]:
        """The numbers (S,B) int64 and parameters (S,B,P) float32 of S steps, each a `stride` after the one before."""
        count = len(steps)
        if steps[0] != self._begin or count > len(self._numbers):
            self._draw(steps[0], max(count, AT_ONCE // len(self._within)))
        taken = self._numbers[:count], self._drawn[:count]
        self._numbers, self._drawn = self._numbers[count:], self._drawn[count:]
        self._begin += count * self._stride
        return taken

    def _draw(self, begin: int, count: int) -> None:
        end = begin + count * self._stride
        end = end if self._stop is None else min(end, self._stop)
        # What is given later may be written into outside of the inference mode that is on now.
        with torch.inference_mode(False):
            starts = torch.arange(begin, end, self._stride, device="cpu") + self._offset
            numbers = starts[:, None] + self._within
        theta = self._theta(numbers.reshape(-1))
        self._begin, self._numbers, self._drawn = begin, numbers, theta.reshape(*numbers.shape, -1)
