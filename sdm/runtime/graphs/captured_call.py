"""One recorded call: a CUDA graph with tensors of its own."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from typing import Any, TypeAlias

import torch
import warp as wp
from torch import Tensor

from sdm.runtime.graph_branches import side_stream
from sdm.runtime.output_slot import Place, placing
from sdm.runtime.torch_warp import on_current_stream, version_of

Say: TypeAlias = Callable[[Tensor], None]
Inputs: TypeAlias = tuple[Tensor, ...]
# Takes a `Say` and tensors, gives tensors.
Work: TypeAlias = Callable[..., tuple[Tensor, ...]]

MOST_REMARKS = 4
UNSAID = -1


def unheard(remarks: Tensor) -> None:
    """Remarks that nobody waits for."""


def _nothing() -> None:
    """As a reference to a tensor that is gone."""


class Room:
    """Memory that several recordings of one device share: each launch waits for the one before.

    Args:
        before: The room that this one takes the place of, whose launches it waits for too.
    """

    def __init__(self, before: Room | None = None) -> None:
        self.nbytes = 0
        # Launches of all its recordings so far.
        self.launches = 0
        self._pool: Any = None
        self._stream: torch.cuda.Stream | None = before._stream if before else None
        self.last: torch.cuda.Event | None = before.last if before else None

    def open(self) -> tuple[torch.cuda.Stream, Any]:
        """The stream to record on and the pool to take memory from, of the current device."""
        if self._stream is None:
            self._stream = torch.cuda.Stream()
        if self.last is None:
            self.last = torch.cuda.Event()
        if self._pool is None:
            self._pool = torch.cuda.graph_pool_handle()
        return self._stream, self._pool


class Held:
    """Which tensor's numbers each of a recording's own inputs has: those of the last launch, if they are still there.

    Recordings of one room share its memory, so that another one's scratch may lie where the inputs of this one do.

    Args:
        room: Whose launches are counted.
        count: How many inputs there are.
    """

    def __init__(self, room: Room, count: int) -> None:
        self._room = room
        # Of each input which tensor was copied last, and that one's version.
        self._given: list[tuple[Callable[[], Tensor | None], int | None]] = [(_nothing, None)] * count
        self._launch = 0

    def begin(self) -> None:
        """One more launch of the room's begins, which is this recording's."""
        if self._room.launches != self._launch:
            # Others came in between.
            self._given = [(_nothing, None)] * len(self._given)
        self._room.launches += 1
        self._launch = self._room.launches

    def has(self, place: int, given: Tensor) -> bool:
        """Whether an input need not be copied.

        That is asked only of faces and what is known of them, which `sdm.topology.boundary_edges` remembers by the same
        rule. A stream's are the same in every batch, and to copy them was a seventh of what a call takes the host.
        """
        before, version = self._given[place]
        return version is not None and before() is given and version == _version_of_faces(given)

    def note(self, place: int, given: Tensor) -> None:
        """An input was copied."""
        self._given[place] = weakref.ref(given), _version_of_faces(given)


def _version_of_faces(given: Tensor) -> int | None:
    return version_of(given) if given.dtype == torch.int32 else None


class Recording:
    """`work(say, *inputs)`, recorded: for other inputs of the same shapes.

    Args:
        room: Where to take memory.
        work: Queues kernels.
        inputs: As those to come; the work is done once with them, without a result.
    """

    def __init__(self, room: Room, work: Work, inputs: Inputs) -> None:
        self.turn = threading.Lock()
        self._room = room
        self._device = inputs[0].device
        self._guesses, self._count = False, 0
        self._held = Held(room, len(inputs))
        self._heard = torch.cuda.Event(external=True)
        with (
            torch.cuda.device(self._device),
            torch.inference_mode(False),
            torch.no_grad(),
            torch.autocast("cuda", enabled=False),
        ):
            self._place = Place(self._device)
            self._said = torch.zeros(MOST_REMARKS, dtype=torch.int32, pin_memory=True)
            # Loads what is loaded on first use, which a capture does not allow.
            work(unheard, *inputs)
            stream, pool = room.open()
            side_stream(stream.device_index)
            before = torch.cuda.memory_reserved()
            with torch.cuda.stream(stream), on_current_stream(inputs[0]) as device:
                self._capture(work, inputs, device.stream, pool)
            room.nbytes += max(0, torch.cuda.memory_reserved() - before)
            self._place_is_made(torch.cuda.current_stream())

    def _place_is_made(self, stream: torch.cuda.Stream) -> None:
        """A launch on another stream waits until the place's memory is this recording's."""
        last = self._room.last
        if last is not None:
            # And, as every launch, for the one before.
            stream.wait_event(last)
            last.record(stream)

    def _capture(self, work: Work, inputs: Inputs, stream: wp.Stream, pool: Any) -> None:
        self._graph = torch.cuda.CUDAGraph()
        # Other threads go on with what they do, on other streams.
        self._graph.capture_begin(pool=pool, capture_error_mode="thread_local")
        try:
            # Warp is told, so that its memory for sorting becomes the graph's, and its kernels stay loaded.
            wp.capture_begin(stream=stream, external=True, force_module_load=False)
            try:
                self._inputs = tuple(torch.empty_like(given) for given in inputs)
                with placing(self._place):
                    self._results = work(self._say, *self._inputs)
            finally:
                self._warp = wp.capture_end(stream=stream)
        finally:
            self._graph.capture_end()

    def _say(self, remarks: Tensor) -> None:
        self._guesses = True
        self._count = remarks.shape[0]
        self._said[: self._count].copy_(remarks, non_blocking=True)
        self._heard.record()

    def launch(self, inputs: Inputs) -> tuple[Tensor, ...]:
        """Queue the work for these inputs on the current stream of their device: new tensors."""
        last = self._room.last
        if last is None:
            raise RuntimeError("a room without a recording")
        with torch.cuda.device(self._device), torch.no_grad():
            stream = torch.cuda.current_stream()
            stream.wait_event(last)
            try:
                return self._queue(inputs, stream)
            finally:
                last.record(stream)

    def _queue(self, inputs: Inputs, stream: torch.cuda.Stream) -> tuple[Tensor, ...]:
        self._held.begin()
        for place, given in enumerate(inputs):
            if given.numel() and not self._held.has(place, given):
                self._inputs[place].copy_(given)
                given.record_stream(stream)
                self._held.note(place, given)
        if self._guesses:
            self._said[: self._count].fill_(UNSAID)
        # The first result, if it is a map, is written where it is wanted; the others are copied.
        placed = self._place.put()
        self._graph.replay()
        first = () if placed is None else (placed,)
        return *first, *(result.clone() for result in self._results[len(first) :])

    def guessed_right(self) -> bool:
        """Whether the last launch's guess was right: waits for its remarks, if it makes any, and for nothing else."""
        if not self._guesses:
            return True
        self._heard.synchronize()
        if UNSAID in self._said.tolist() and self._room.last is not None:
            # A driver that does not take launches into account: the results' own event comes last.
            self._room.last.synchronize()
        return not any(self._said.tolist())
