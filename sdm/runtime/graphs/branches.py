"""Branches of a CUDA graph: work beside other work, so that a GPU that one kernel does not fill runs two.

The host hands a graph to the GPU node by node, about as they were queued, and the GPU begins before it has them all. So
what everything waits for is queued first, and branches not before they are needed: `since` says where they begin.

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


# Branches that a graph may have beside each other; those of frames, winding numbers, and caps' moments for these.
BRANCHES, FRAMES, WINDING, MOMENTS = 5, 2, 3, 4
# Priority of the stream that is recorded, and of its branches but for the last two: of kernels that wait for a
# multiprocessor lists come before winding numbers, which are needed later.
FIRST, LATER = -1, 0


@cache
def side_streams(index: int) -> tuple[torch.cuda.Stream, ...]:
    """The streams of a GPU that become the branches of every graph; made before a recording begins."""
    streams = tuple(torch.cuda.Stream(index, LATER if i in (WINDING, MOMENTS) else FIRST) for i in range(BRANCHES))
    for stream in streams:
        warp_stream(torch.device("cuda", index), stream)
    return streams


def fork(device: torch.device) -> Join:
    """A `Join` that waits for what was queued on the current stream until now, and no more."""
    if not is_recording(device):
        return nothing
    here = torch.cuda.Event()
    here.record(torch.cuda.current_stream(device.index))
    return lambda: torch.cuda.current_stream(device.index).wait_event(here)


@contextmanager
def beside(
    device: torch.device, branch: int = 0, after: Join | None = None, since: Join | None = None
) -> Iterator[Join]:
    """Queue what is queued inside on a branch of the graph being recorded.

    Gives a function that makes the stream that is current when it is called wait for the branch: to be called after the
    block, at last on the stream that was current before it. What the branch reads and writes has to live until then.
    Blocks of one branch follow each other, and do not lie within each other.

    Args:
        device: Of the graph.
        branch: Which, of BRANCHES.
        after: What of another branch comes before it.
        since: What of the current stream comes before it, in place of all that is queued there.
    """
    if not is_recording(device):
        yield nothing
        return
    main = torch.cuda.current_stream(device.index)
    side = side_streams(main.device_index)[branch]
    if since is None:
        side.wait_stream(main)
    done = torch.cuda.Event()

    def join() -> None:
        torch.cuda.current_stream(main.device_index).wait_event(done)

    with torch.cuda.stream(side):
        for before in (since, after):
            if before is not None:
                before()
        yield join
        done.record(side)


@contextmanager
def kernels_beside(
    tensor: Tensor, branch: int = 0, after: Join | None = None, since: Join | None = None
) -> Iterator[Join]:
    """`beside`, for Warp's kernels on `tensor`'s device, whose current stream is Warp's already."""
    if not is_recording(tensor.device):
        yield nothing
        return
    with beside(tensor.device, branch, after, since) as join, on_current_stream(tensor):
        yield join


def is_recording(device: torch.device) -> bool:
    """True if a CUDA graph is being recorded on the device's current stream."""
    return device.type == "cuda" and torch.cuda.is_current_stream_capturing()


def nothing() -> None:
    """A `Join` that waits for nothing."""
