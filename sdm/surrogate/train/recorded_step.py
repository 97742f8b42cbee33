"""A step of a training as a CUDA graph: the host's share of it, several milliseconds, is paid once."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

# Steps before the recording, which compile and load what is used for the first time.
FIRST = 3


class RecordedStep:
    """`work(*inputs)`, recorded: for other inputs of the same shapes.

    Args:
        work: Moves weights that stay where they are, and gives tensors. It is done a few times before it is recorded,
            each time as a step of the training.
        inputs: As those to come, on the device.
    """

    def __init__(self, work: Callable[..., tuple[Tensor, ...]], inputs: tuple[Tensor, ...]) -> None:
        self._inputs = tuple(given.clone() for given in inputs)
        current, side = torch.cuda.current_stream(), torch.cuda.Stream()
        side.wait_stream(current)
        with torch.cuda.stream(side):
            for _ in range(FIRST):
                work(*self._inputs)
        current.wait_stream(side)
        self._graph = torch.cuda.CUDAGraph()
        # Other threads go on with what they do.
        with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
            self._results = work(*self._inputs)

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """The results, which the next call writes over."""
        for own, given in zip(self._inputs, inputs, strict=True):
            own.copy_(given)
        self._graph.replay()
        return self._results
