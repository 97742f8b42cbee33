"""Number of torch threads, one for work of many small operations on a CPU."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

# Images of fewer voxels than this are no work for several threads.
SMALLEST_SHARED = 1 << 19


@contextmanager
def one_thread_for(voxels: int, device: torch.device) -> Iterator[None]:
    """One torch thread for small images on a CPU; as many as before for others, and afterwards.

    A fit, for example, does thousands of small operations, between which the engine uses all cores. Torch's idle
    threads keep theirs busy waiting for the next operation, which slows the engine down, and many times so where other
    programs run too.
    """
    share = device.type != "cpu" or voxels >= SMALLEST_SHARED
    with threads(torch.get_num_threads() if share else 1):
        yield


@contextmanager
def threads(count: int) -> Iterator[None]:
    """So many torch threads; as many as before afterwards."""
    before = torch.get_num_threads()
    if count == before:
        yield
        return
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
