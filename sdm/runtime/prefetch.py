"""Prefetch: batches made a few steps before they are needed, on a CUDA stream of their own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import TypeVar

import torch
from torch import Tensor

B = TypeVar("B", bound=tuple[Tensor, ...])


def prefetch(
    make: Callable[[list[int]], Sequence[B]],
    steps: Iterator[int],
    device: torch.device,
    count: int,
    together: int = 1,
) -> Iterator[tuple[int, B]]:
    """(step, batch) for each step: on a GPU at least `count` batches queued on a side stream before they are requested.

    Elsewhere each is made when it is requested.

    `make` gives the batches of several steps at once: of `together`, but for the last. Each batch is new memory. The
    consumer's stream, the one that is current when a batch is requested, waits for that batch on the device; the host
    waits for nothing. The allocator is told that the consumer's stream reads the batch, so its memory is free for reuse
    only after what was queued there up to the moment the batch is let go. Tensors of a batch on the host are left
    alone.
    """
    if device.type != "cuda":
        for step in steps:
            yield step, make([step])[0]
        return
    side = torch.cuda.Stream(device)
    # What `make` keeps on the device may still be on its way there.
    side.wait_stream(torch.cuda.current_stream(device))
    ready: deque[tuple[int, B, torch.cuda.Event]] = deque()

    def queue() -> None:
        several = list(islice(steps, together))
        if not several:
            return
        with torch.cuda.device(device), torch.cuda.stream(side):
            batches = make(several)
            done = torch.cuda.Event()
            done.record(side)
        ready.extend((step, batch, done) for step, batch in zip(several, batches, strict=True))

    for _ in range(-(-count // together)):
        queue()
    while ready:
        step, batch, done = ready.popleft()
        if len(ready) < max(count, together):
            # Queued before the consumer's next work, so that the device always has a batch to make.
            queue()
        consumer = torch.cuda.current_stream(device)
        consumer.wait_event(done)
        _is_read(batch, consumer)
        yield step, batch
        # A generator's own names would keep the batch until the next one is there.
        del batch


def _is_read(batch: tuple[Tensor, ...], stream: torch.cuda.Stream) -> None:
    for tensor in batch:
        if tensor.is_cuda:
            tensor.record_stream(stream)
