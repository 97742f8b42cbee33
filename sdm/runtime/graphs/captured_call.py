"""One recorded call: a CUDA graph with tensors of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeAlias

import torch
import warp as wp
from torch import Tensor

from sdm.runtime.graphs.branches import side_streams
from sdm.runtime.graphs.memory_pool import InputCache, MemoryPool
from sdm.runtime.graphs.output_slot import OutputSlot, capturing_into
from sdm.runtime.torch_warp import on_current_stream

# Takes flags, zeros if a guess is right, and behind them as many other numbers as it is told, for the host to know.
Verify: TypeAlias = Callable[..., None]
Tensors: TypeAlias = tuple[Tensor, ...]
# Takes a `Verify` and tensors, gives tensors.
Work: TypeAlias = Callable[..., Tensors]
# Takes a recording's own tensors, gives new ones, or None if they are not what was wanted.
Finish: TypeAlias = Callable[[Tensors], "Tensors | None"]

MOST_FLAGS = 8
PENDING = -1


def unverified(flags: Tensor, told: int = 0) -> None:
    """The `Verify` of work whose guesses are known to be right, or whose results nobody looks at."""


class CapturedCall:
    """`work(verify, *inputs)`, recorded: for other inputs of the same shapes.

    Args:
        pool: Where to take memory.
        work: Queues kernels.
        inputs: As those to come; the work is done once with them, without a result.
    """

    def __init__(self, pool: MemoryPool, work: Work, inputs: Tensors) -> None:
        self.lock = threading.Lock()
        self._pool = pool
        self._device = inputs[0].device
        self._guesses, self._count, self._told = False, 0, 0
        self._held = InputCache(pool, len(inputs))
        self._verified = torch.cuda.Event(external=True)
        with (
            torch.cuda.device(self._device),
            torch.inference_mode(False),
            torch.no_grad(),
            torch.autocast("cuda", enabled=False),
        ):
            self._slot = OutputSlot(self._device)
            self._flags = torch.zeros(MOST_FLAGS, dtype=torch.int32, pin_memory=True)
            # Loads what is loaded on first use, which a capture does not allow.
            work(unverified, *inputs)
            stream, handle = pool.open()
            side_streams(stream.device_index)
            before = torch.cuda.memory_reserved()
            with torch.cuda.stream(stream), on_current_stream(inputs[0]) as device:
                self._capture(work, inputs, device.stream, handle)
            pool.nbytes += max(0, torch.cuda.memory_reserved() - before)
            self._slot_is_made(torch.cuda.current_stream())

    def _slot_is_made(self, stream: torch.cuda.Stream) -> None:
        """A launch on another stream waits until the slot's memory is this recording's."""
        last = self._pool.last
        if last is not None:
            # And, as every launch, for the one before.
            stream.wait_event(last)
            last.record(stream)

    def _capture(self, work: Work, inputs: Tensors, stream: wp.Stream, handle: Any) -> None:
        self._graph = torch.cuda.CUDAGraph()
        # Other threads go on with what they do, on other streams.
        self._graph.capture_begin(pool=handle, capture_error_mode="thread_local")
        try:
            # Warp is told, so that its memory for sorting becomes the graph's, and its kernels stay loaded.
            wp.capture_begin(stream=stream, external=True, force_module_load=False)
            try:
                self._inputs = tuple(torch.empty_like(given) for given in inputs)
                with capturing_into(self._slot):
                    self._results = work(self._verify, *self._inputs)
            finally:
                self._warp = wp.capture_end(stream=stream)
        finally:
            self._graph.capture_end()

    def _verify(self, flags: Tensor, told: int = 0) -> None:
        self._guesses = True
        self._count, self._told = flags.shape[0], told
        self._flags[: self._count].copy_(flags, non_blocking=True)
        self._verified.record()

    def launch(self, inputs: Tensors, finish: Finish | None = None) -> Tensors | None:
        """Queue the work for these inputs on the current stream of their device: new tensors.

        Or what `finish` makes of the recording's own, which the next launch of any recording may write over.
        """
        last = self._pool.last
        if last is None:
            raise RuntimeError("a pool without a recording")
        with torch.cuda.device(self._device), torch.no_grad():
            # By its number, as torch looks for the current device otherwise.
            stream = torch.cuda.current_stream(self._device.index)
            stream.wait_event(last)
            try:
                return self._queue(inputs, stream, finish)
            finally:
                last.record(stream)

    def _queue(self, inputs: Tensors, stream: torch.cuda.Stream, finish: Finish | None) -> Tensors | None:
        self._held.begin()
        for index, given in enumerate(inputs):
            if given.numel() and not self._held.holds(index, given):
                own = self._inputs[index]
                # Of inputs that need not fill their room, the kernels know how many rows there are.
                (own if own.shape == given.shape else own[: given.shape[0]]).copy_(given, non_blocking=True)
                if given.is_cuda:
                    given.record_stream(stream)
                self._held.copied(index, given)
        if self._guesses:
            self._flags[: self._count].fill_(PENDING)
        # The first result, if it is a map, is written to the slot's new tensor; the others are copied.
        values = self._slot.new_output()
        self._graph.replay()
        if finish is not None:
            return finish(self._results)
        first = () if values is None else (values,)
        return *first, *(result.clone() for result in self._results[len(first) :])

    def guessed_right(self) -> tuple[bool, list[int]]:
        """True if the last launch's guess was right, and all numbers handed to `verify`.

        Waits for these, if there are any, and for nothing else.
        """
        if not self._guesses:
            return True, []
        self._verified.synchronize()
        said = self._flags.tolist()
        if PENDING in said and self._pool.last is not None:
            # A driver that does not take launches into account: the results' own event comes last.
            self._pool.last.synchronize()
            said = self._flags.tolist()
        return not any(said[: self._count - self._told]), said[: self._count]
