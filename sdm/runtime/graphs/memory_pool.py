"""Memory that the recordings of one device share, and what of it is still in place from one launch to the next."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from sdm.runtime.graphs.branches import FIRST
from sdm.runtime.torch_warp import version_of


def _nothing() -> None:
    """As a reference to a tensor that is gone."""


class LastLaunch:
    """The last launch of all recordings of a device."""

    def __init__(self) -> None:
        self.event = torch.cuda.Event()
        # If it was on the default stream.
        self.by_default = False


class MemoryPool:
    """Memory that several recordings of one device share: each launch waits for the one before.

    Args:
        before: The pool that this one replaces, whose launches it waits for too.
    """

    def __init__(self, before: MemoryPool | None = None) -> None:
        self.nbytes = 0
        # Launches of all its recordings so far.
        self.launches = 0
        self._handle: Any = None
        self._stream: torch.cuda.Stream | None = before._stream if before else None
        self.last: LastLaunch | None = before.last if before else None

    def open(self) -> tuple[torch.cuda.Stream, Any]:
        """The stream to record on and torch's handle of the pool, of the current device."""
        if self._stream is None:
            self._stream = torch.cuda.Stream(priority=FIRST)
        if self.last is None:
            self.last = LastLaunch()
        if self._handle is None:
            self._handle = torch.cuda.graph_pool_handle()
        return self._stream, self._handle

    @property
    def last_launch(self) -> torch.cuda.Event | None:
        """Event after the last launch."""
        return self.last.event if self.last else None

    def begin_launch(self, stream: torch.cuda.Stream) -> None:
        """Make a stream wait for the launch before."""
        if self.last is None:
            raise RuntimeError("a pool without a recording")
        # Of two streams with one handle that are not the default one nobody knows that they are one.
        if not (self.last.by_default and stream.cuda_stream == 0):
            stream.wait_event(self.last.event)

    def end_launch(self, stream: torch.cuda.Stream) -> None:
        """Take note of the launch that was queued on a stream."""
        if self.last is not None:
            self.last.event.record(stream)
            self.last.by_default = stream.cuda_stream == 0

    def finish(self) -> None:
        """Wait for the last launch."""
        if self.last is not None:
            self.last.event.synchronize()


class InputCache:
    """The tensors whose numbers a recording's own inputs hold: those of the last launch, if nothing came in between.

    Recordings of one pool share its memory, so that another one's scratch may lie where the inputs of this one do.

    Args:
        pool: Whose launches are counted.
        count: How many inputs there are.
    """

    def __init__(self, pool: MemoryPool, count: int) -> None:
        self._pool = pool
        # Of each input which tensor was copied last, and that one's version.
        self._copied: list[tuple[Callable[[], Tensor | None], int | None]] = [(_nothing, None)] * count
        self._launch = 0

    def begin(self) -> None:
        """One more launch of the pool's begins, which is this recording's."""
        if self._pool.launches != self._launch:
            # Others came in between.
            self._copied = [(_nothing, None)] * len(self._copied)
        self._pool.launches += 1
        self._launch = self._pool.launches

    def holds(self, index: int, given: Tensor) -> bool:
        """True if an input need not be copied.

        That is asked only of whole numbers: faces and what is known of them, which `sdm.topology` remembers by the same
        rule, and acceleration structures, which nobody writes into once they are built. A stream's faces are the same
        in every batch, and to copy them was a seventh of what a call takes the host.
        """
        before, version = self._copied[index]
        return version is not None and before() is given and version == _version_of_constant(given)

    def copied(self, index: int, given: Tensor) -> None:
        """An input was copied."""
        self._copied[index] = weakref.ref(given), _version_of_constant(given)


def _version_of_constant(given: Tensor) -> int | None:
    return None if given.dtype.is_floating_point else version_of(given)
