"""Batches made a few steps before they are needed, on a CUDA stream of their own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import torch

from sdm.stream.batch import Batch


def one_by_one(make: Callable[[int], Batch], steps: Iterator[int]) -> Iterator[tuple[int, Batch]]:
    """(step, batch) for each step, made when it is asked for."""
    for step in steps:
        yield step, make(step)


def ahead(
    make: Callable[[int], Batch], steps: Iterator[int], device: torch.device, count: int
) -> Iterator[tuple[int, Batch]]:
    """(step, batch) for each step, `count` batches queued on a side stream before they are asked for.

    Each batch is new memory. The consumer's stream, the one that is current when a batch is asked for, waits for that
    batch on the device; the host waits for nothing. The allocator is told that the consumer's stream reads the batch,
    so its memory is free for reuse only after what was queued there up to the moment the batch is let go.
    """
    side = torch.cuda.Stream(device)
    # What the family keeps on the device may still be on its way there.
    side.wait_stream(torch.cuda.current_stream(device))
    ready: deque[tuple[int, Batch, torch.cuda.Event]] = deque()

    def queue() -> None:
        step = next(steps, None)
        if step is None:
            return
        with torch.cuda.device(device), torch.cuda.stream(side):
            batch = make(step)
            done = torch.cuda.Event()
            done.record(side)
        ready.append((step, batch, done))

    for _ in range(count):
        queue()
    while ready:
        step, batch, done = ready.popleft()
        # Queued before the consumer's next work, so that the device always has a batch to make.
        queue()
        consumer = torch.cuda.current_stream(device)
        consumer.wait_event(done)
        batch.theta.record_stream(consumer)
        batch.sdm.record_stream(consumer)
        yield step, batch
        # A generator's own names would keep the batch until the next one is there.
        del batch
