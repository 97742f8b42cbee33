"""One recorded call: a CUDA graph with memory of its own."""

from __future__ import annotations

import threading
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import torch
import warp as wp
from torch import Tensor

from sdm.runtime.graphs.branches import side_streams
from sdm.runtime.graphs.memory_pool import InputCache, MemoryPool
from sdm.runtime.graphs.output_slot import OutputSlot, capturing_into
from sdm.runtime.torch_warp import current_device, on_current_stream, raw_stream

# Queues a kernel that writes flags to an address.
WriteFlags: TypeAlias = Callable[[int], None]
# Takes flags, zeros if a guess is right, and behind them as many other numbers as it is told, for the host to know.
# They are copied, or a `WriteFlags` that it is given writes them.
Verify: TypeAlias = Callable[..., None]
Tensors: TypeAlias = tuple[Tensor, ...]
# Takes a `Verify` and tensors, gives tensors.
Work: TypeAlias = Callable[..., Any]
# Takes a recording's own tensors, gives new ones, or None if they are not what was wanted.
Finish: TypeAlias = Callable[[Tensors], "Tensors | None"]

MOST_FLAGS = 8
PENDING = -1
_ALL_PENDING = memoryview(array("i", MOST_FLAGS * [PENDING]))
# Looks at the numbers told before the host asks the driver to wait: of a small map they come within that time, and to
# ask takes as long as some kernels.
LOOKS = 2000


def unverified(flags: Tensor, told: int = 0, write: WriteFlags | None = None) -> None:
    """The `Verify` of work whose guesses are known to be right, or whose results nobody looks at."""
    if write is not None:
        write(torch.empty_like(flags).data_ptr())


class Recording:
    """A call's work as a CUDA graph, and what it tells the host.

    Args:
        pool: Where to take memory.
        device: Of the work.
    """

    def __init__(self, pool: MemoryPool, device: torch.device) -> None:
        self.lock = threading.Lock()
        self._pool, self._device = pool, device
        self._guesses, self._count, self._told = False, 0, 0
        self._verified = torch.cuda.Event(external=True)
        self._flags = torch.zeros(MOST_FLAGS, dtype=torch.int32, pin_memory=True)
        # The same memory: the host writes and reads a few numbers.
        self._said = self._flags.numpy().data

    def _record(self, queue: Callable[[], None]) -> None:
        """Make the graph of what `queue` queues, in memory that goes with the graph."""
        stream, handle = self._pool.open()
        side_streams(stream.device_index)
        before = torch.cuda.memory_reserved()
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.stream(stream), on_current_stream(self._place()) as device:
            # Other threads go on with what they do, on other streams.
            self._graph.capture_begin(pool=handle, capture_error_mode="thread_local")
            try:
                # Warp is told, so that its memory for sorting becomes the graph's, and its kernels stay loaded.
                wp.capture_begin(stream=device.stream, external=True, force_module_load=False)
                try:
                    queue()
                finally:
                    self._warp = wp.capture_end(stream=device.stream)
            finally:
                self._graph.capture_end()
        self._pool.nbytes += max(0, torch.cuda.memory_reserved() - before)
        # Without torch's method around it.
        self._replay = super(torch.cuda.CUDAGraph, self._graph).replay

    def _place(self) -> Tensor:
        """A tensor without content on the device."""
        return torch.empty(0, device=self._device)

    def _verify(self, flags: Tensor, told: int = 0, write: WriteFlags | None = None) -> None:
        self._guesses = True
        self._count, self._told = flags.shape[0], told
        if write is None:
            self._flags[: self._count].copy_(flags, non_blocking=True)
        else:
            write(self._flags.data_ptr())
        self._verified.record()

    def guessed_right(self) -> tuple[bool, list[int]]:
        """True if the last launch's guess was right, and all numbers handed to `verify`.

        Waits for these, if there are any, and for nothing else.
        """
        if not self._guesses:
            return True, []
        said = self._said[: self._count].tolist()
        looks = LOOKS
        while PENDING in said and looks:
            said = self._said[: self._count].tolist()
            looks -= 1
        if PENDING in said:
            self._verified.synchronize()
            said = self._said[: self._count].tolist()
        if PENDING in said:
            # A driver that does not take launches into account: the results' own event comes last.
            self._pool.finish()
            said = self._said[: self._count].tolist()
        return not any(said[: self._count - self._told]), said


class CapturedCall(Recording):
    """`work(verify, *inputs)`, recorded: for other inputs of the same shapes.

    It is launched by `launch` alone: a graph that is replayed by hand after another recording's reads that one's
    scratch in the place of its inputs (bench/decisions/0067-blocks-of-a-thread-block.md).

    Args:
        pool: Where to take memory.
        work: Queues kernels, and gives tensors.
        inputs: As those to come; the work is done once with them, without a result.
    """

    def __init__(self, pool: MemoryPool, work: Work, inputs: Tensors) -> None:
        super().__init__(pool, inputs[0].device)
        self._held = InputCache(pool, len(inputs))
        with _plain(self._device):
            self._slot = OutputSlot(self._device)
            # Loads what is loaded on first use, which a capture does not allow.
            work(unverified, *inputs)
            self._record(partial(self._queue_own, work, inputs))
            # A launch on another stream waits until the slot's memory is this recording's.
            stream = torch.cuda.current_stream()
            pool.begin_launch(stream)
            pool.end_launch(stream)

    def _queue_own(self, work: Work, alike: Tensors) -> None:
        self._inputs = tuple(torch.empty_like(given) for given in alike)
        with capturing_into(self._slot):
            self._results = work(self._verify, *self._inputs)

    def launch(self, inputs: Tensors, finish: Finish | None = None) -> Tensors | None:
        """Queue the work for these inputs on the current stream of their device: new tensors.

        Or what `finish` makes of the recording's own, which the next launch of any recording may write over.
        """
        with torch.cuda.device(self._device), torch.no_grad():
            # By its number, as torch looks for the current device otherwise.
            stream = torch.cuda.current_stream(self._device.index)
            self._pool.begin_launch(stream)
            try:
                return self._queue(inputs, stream, finish)
            finally:
                self._pool.end_launch(stream)

    def _queue(self, inputs: Tensors, stream: torch.cuda.Stream, finish: Finish | None) -> Tensors | None:
        self._held.begin()
        for index, given in enumerate(inputs):
            if given.numel() and not self._held.holds(index, given):
                self._inputs[index].copy_(given, non_blocking=True)
                given.record_stream(stream)
                self._held.copied(index, given)
        if self._guesses:
            self._said[: self._count] = _ALL_PENDING[: self._count]
        # The first result, if it is a map, is written to the slot's new tensor; the others are copied.
        values = self._slot.new_output()
        self._replay()
        if finish is not None:
            return finish(self._results)
        first = () if values is None else (values,)
        return *first, *(result.clone() for result in self._results[len(first) :])


class Table(NamedTuple):
    """The table of a `TableRecording`.

    Args:
        device: Of the work.
        length: In numbers of 8 bytes.
        new: Makes the tensors that results go to, the same for all calls of a recording.
        spare: How many of these may be kept for the next calls.
        fill: Writes the table, which holds zeros or what it wrote last, with the addresses of those tensors, and gives
            the results.
        family: Works of one family launch the same kernels, or nearly.
    """

    device: torch.device
    length: int
    new: Callable[[], Any]
    spare: int
    fill: Callable[[Any, Any], Any]
    family: str


# Families whose work was done on a device.
_loaded: set[tuple[torch.device, str]] = set()


class TableRecording(Recording):
    """`work(verify, table)`, recorded: a table on the host says where its inputs are, and where results go.

    So a launch is all that the host asks the driver for.

    Args:
        pool: Where to take memory.
        work: Queues kernels that read the table from pinned memory, and write results to addresses in it.
        table: What is known of that.
    """

    def __init__(self, pool: MemoryPool, work: Work, table: Table) -> None:
        super().__init__(pool, table.device)
        self._index = table.device.index
        self._default = torch.cuda.default_stream(table.device)
        self._new, self._most_spare = table.new, table.spare
        self._spare: list[Any] = []
        with _plain(table.device):
            self._table = _pinned(table.length)
            self._room = self._table.numpy().data
            queue = partial(self._queue_own, work)
            if (table.device, table.family) not in _loaded:
                _do_once(work, table)
                _loaded.add((table.device, table.family))
                self._record(queue)
                return
            try:
                # The work need not be done before, which would take as long again: what other sizes have of their own
                # is loaded while it is recorded.
                self._record(queue)
            except RuntimeError:
                _do_once(work, table)
                self._record(queue)

    def _queue_own(self, work: Work) -> None:
        work(self._verify, self._table)

    def launch(self, fill: Callable[..., Any], reads: Tensors, about: tuple[Any, ...] = ()) -> Any:
        """Queue the work on the current stream: what `fill` gives, with new tensors, which the work will fill.

        Args:
            fill: Writes the table.
            reads: The tensors whose addresses it writes and which are read.
            about: What else `fill` is given.
        """
        index = self._index
        if index != current_device():
            with torch.cuda.device(self._device):
                return self.launch(fill, reads, about)
        if self._guesses:
            if self._said[0] == PENDING:
                # A launch that nobody waited for: it still may have to read the table.
                self.guessed_right()
            self._said[: self._count] = _ALL_PENDING[: self._count]
        pool, spare = self._pool, self._spare
        # Tensors are another stream's until it has done what was queued when they were made.
        by_default = raw_stream(index) == 0
        results = fill(self._room, spare.pop() if spare and by_default else self._new(), *about)
        # What need not come before the launch comes after it.
        stream, last = None, pool.last
        if not (by_default and last is not None and last.by_default):
            stream = torch.cuda.current_stream(index)
            pool.begin_launch(stream)
        try:
            pool.launches += 1
            self._replay()
        finally:
            if stream is None:
                stream = self._default if by_default else torch.cuda.current_stream(index)
            for given in reads:
                given.record_stream(stream)
            pool.end_launch(stream)
        if by_default and not spare:
            # Several at a time, while the device is at work: to ask torch for the first one takes the host as long as a
            # launch, as other work has emptied the processor's caches since.
            spare += [self._new() for _ in range(self._most_spare)]
        return results


def _do_once(work: Work, table: Table) -> None:
    """Load what is loaded on first use, by the work with a table of its own."""
    once = _pinned(table.length)
    results = table.fill(once.numpy().data, table.new())
    work(unverified, once)
    # Nobody else knows that the device reads it.
    torch.cuda.current_stream().synchronize()
    del results, once


def _pinned(length: int) -> Tensor:
    return torch.zeros(length, dtype=torch.float64, device="cpu", pin_memory=True)


@contextmanager
def _plain(device: torch.device) -> Iterator[None]:
    """On a device, without what a caller may have turned on."""
    with (
        torch.cuda.device(device),
        torch.inference_mode(False),
        torch.no_grad(),
        torch.autocast("cuda", enabled=False),
    ):
        yield
