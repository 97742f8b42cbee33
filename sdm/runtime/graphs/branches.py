"""Branches of a CUDA graph: work beside other work, so that a GPU that one kernel does not fill runs two.

Only while a CUDA graph is recorded: there a side stream becomes a branch of the graph, and memory stays the graph's
until it goes. Outside of one all work stays on the current stream, where torch knows when memory is free again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TypeAlias

import torch
from torch import Tensor

from sdm.runtime.torch_warp import on_current_stream, warp_stream

Join: TypeAlias = Callable[[], None]


# Branches that a graph may have.
BRANCHES = 3


@cache
def side_stream(index: int, branch: int = 0) -> torch.cuda.Stream:
    """The stream of a GPU that becomes a branch of every graph; made before a recording begins."""
    stream = torch.cuda.Stream(index)
    warp_stream(torch.device("cuda", index), stream)
    return stream


def make_side_streams(index: int) -> None:
    """Make the streams of all branches of a GPU's graphs."""
    for branch in range(BRANCHES):
        side_stream(index, branch)


@contextmanager
def beside(device: torch.device, branch: int = 0) -> Iterator[Join]:
    """Queue what is queued inside on a branch, one of `BRANCHES`, of the graph being recorded.

    Gives a function that makes the current stream wait for the branch: to be called, once, after the block. What the
    branch reads and writes has to live until then. Blocks of one branch follow each other and do not
    lie within each other; those of several run beside each other.
    """
    if not is_recording(device):
        yield _nothing
        return
    main = torch.cuda.current_stream()
    side = side_stream(main.device_index, branch)
    side.wait_stream(main)
    done = torch.cuda.Event()

    def join() -> None:
        main.wait_event(done)

    with torch.cuda.stream(side):
        yield join
        done.record(side)


@contextmanager
def kernels_beside(tensor: Tensor, branch: int = 0) -> Iterator[Join]:
    """`beside`, for Warp's kernels on `tensor`'s device, whose current stream is Warp's already."""
    if not is_recording(tensor.device):
        yield _nothing
        return
    with beside(tensor.device, branch) as join, on_current_stream(tensor):
        yield join


def is_recording(device: torch.device) -> bool:
    """True if a CUDA graph is being recorded on the device's current stream."""
    return device.type == "cuda" and torch.cuda.is_current_stream_capturing()


def _nothing() -> None:
    pass
