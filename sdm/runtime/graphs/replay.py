"""The entrance to CUDA graphs: calls are replayed, or made and counted."""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from sdm.runtime.graphs.captured_call import (
    CapturedCall,
    Finish,
    Recording,
    Table,
    TableRecording,
    Tensors,
    Work,
    unverified,
)
from sdm.runtime.graphs.graph_cache import GraphCache, Kept
from sdm.runtime.operators import is_eager
from sdm.runtime.torch_warp import current_device, is_capturing, raw_stream

# What a call by table gives.
R = TypeVar("R")
# The part of a device's memory that recordings may keep.
SHARE = 16
# And how many they are of single kinds of calls, and of calls of many kinds: for each grid's shape a folder of meshes
# has a dozen capacity classes and more (`sdm.engine.capacity`).
MOST_RECORDINGS, MOST_OF_MANY = 32, 128
# Calls that another's recording serves before one is made. That takes a GPU up to 50 us more, and making one takes the
# host 3 ms of one call: only those who go on for long wait for it.
PATIENCE = 600

_switch = SimpleNamespace(on=os.environ.get("SDM_CUDA_GRAPHS", "1") != "0", pauses=0)
_lock = threading.RLock()
_caches: dict[torch.device, GraphCache] = {}


def enable(on: bool) -> None:
    """Turn the recording and replaying of calls on or off; turning it off also does what `clear` does."""
    _switch.on = on
    if not on:
        clear()


@contextmanager
def paused() -> Iterator[None]:
    """Nothing is recorded or replayed meanwhile, by any thread; what is recorded stays."""
    with _lock:
        _switch.pauses += 1
    try:
        yield
    finally:
        with _lock:
            _switch.pauses -= 1


def clear() -> None:
    """Forget all recordings and counts: torch may then use their memory for other tensors, or give it back."""
    with _lock:
        for cache in _caches.values():
            cache.reset()


@dataclass(frozen=True, eq=False)
class Call:
    """A call that can be recorded.

    Args:
        key: Calls with equal keys do the same with inputs of the same shapes and types.
        work: `work(verify, *inputs)` gives tensors. It queues kernels and does nothing else: it neither waits, nor
            remembers its inputs, nor looks at them. What it guesses about them it hands to `verify`, see `speculate`.
        inputs: Tensors on one GPU. Nobody writes into those of whole numbers but by torch.
        finish: Makes new tensors of what a recording's work gave, on the current stream: of results whose lengths the
            host has to read first, which it may do here, while no other recording of the device is launched. None says
            that the work rested on a wrong guess.
    """

    key: Hashable
    work: Work
    inputs: Tensors
    finish: Finish | None = None


class TableWork(NamedTuple):
    """The work that calls by table share, which one recording serves.

    Args:
        key: Calls with equal keys do the same with tables of the same length.
        work: `work(verify, table)` queues kernels, as that of a `Call`; `table` is a tensor on the host, pinned for a
            GPU. Results go where the table says.
        device: Of the work.
        length: Of the table, in numbers of 8 bytes.
        family: Works of one family launch the same kernels, or nearly.
        new: Makes the tensors that results go to.
        spare: How many of these may be kept for the next calls.
        later: By how many calls a recording is made later than before the first.
    """

    key: Hashable
    work: Work
    device: torch.device
    length: int
    family: str
    new: Callable[[], Any]
    spare: int = 0
    later: int = 0


class TableCall(NamedTuple, Generic[R]):
    """A call whose recording serves calls that differ in more than what their tensors hold.

    Args:
        of: What it has in common with those.
        fill: Writes the table, memory of the host which holds zeros or the last call's, with the addresses of new
            tensors, and gives the results.
        reads: The tensors that the work reads by address.
        instead: Gives a call whose recording is there and serves this one too, until it has come so often that a
            recording of its own is worth the time; or None.
        launched: Makes the results of what `fill` gave, while the device is at work: they may turn out to rest on a
            wrong guess.
    """

    of: TableWork
    fill: Callable[[Any, Any], Any]
    reads: Tensors
    instead: Callable[[], TableCall[R] | None] | None = None
    launched: Callable[[Any], R] | None = None


def supports(tensor: Tensor) -> bool:
    """True if a call with this tensor may be recorded and replayed."""
    if not (tensor.is_cuda and _switch.on and not _switch.pauses and is_eager(tensor)):
        return False
    index = tensor.get_device()
    if index == current_device():
        # The default stream is never captured, and to look at its number takes less.
        return raw_stream(index) == 0 or not is_capturing()
    with torch.cuda.device(tensor.device):
        return not torch.cuda.is_current_stream_capturing()


def run(call: Call) -> Tensors:
    """The results of a call whose work guesses nothing: new tensors."""
    results = replay(call)
    if results is None:
        results = call.work(unverified, *call.inputs)
        record(call)
    return results


def speculate(guess: Call, settle: Callable[[], tuple[Tensors, Call | None]]) -> tuple[Tensors, bool]:
    """The results of a call whose work rests on a guess about its inputs, if that was recorded and turns out right.

    Args:
        guess: Its work hands int32 flags to `verify`, which are zeros if the guess is right. They are read while the
            rest of the work is under way.
        settle: Gives the results without a guess, and the call whose guess would have been right, to be recorded.

    Returns:
        The results, and whether they are the guess's.
    """
    results = replay(guess)
    if results is not None:
        return results, True
    results, right = settle()
    if right is not None:
        record(right)
    return results, False


def replay(call: Call) -> Tensors | None:
    """The results of a call's recording; None if there is none, or if it rests on a guess that was wrong.

    One whose guess was wrong is forgotten.
    """
    results, _ = attempt(call)
    if results is None and is_recorded(call.inputs[0].device, call.key):
        with _lock:
            _caches[call.inputs[0].device].drop(call.key)
    return results


def attempt(call: Call) -> tuple[Tensors | None, list[int]]:
    """As `replay`, and all numbers handed to `verify`; the recording is kept, as the next guess may be right.

    No numbers if there is no recording.
    """
    captured = _find(call.inputs[0].device, call.key)
    if not isinstance(captured, CapturedCall):
        return None, []
    with captured.lock:
        with _lock:
            results = captured.launch(call.inputs, call.finish)
        right, said = captured.guessed_right() if results is not None else (False, [])
    return (results if right else None), said


def attempt_by_table(call: TableCall[R]) -> tuple[R | None, list[int]]:
    """The results of a call by its recording, which is made if there is none and it is time, and what it told.

    None and no numbers if there is none; None if the recording's guess was wrong.
    """
    of, instead = call.of, None
    with _lock:
        cache = _caches.get(of.device)
        captured = None if cache is None else cache.find(of.key)
        if captured is None:
            cache = _cache_of(of.device)
            instead = None if call.instead is None else call.instead()
            table = Table(of.device, of.length, of.new, of.spare, call.fill, of.family)
            later = of.later + (PATIENCE if instead else 0)
            cache.count(of.key, of.work, table, for_many=True, capture=TableRecording, later=later)
            captured = cache.find(of.key)
    if captured is None and instead is not None:
        return attempt_by_table(instead)
    if not isinstance(captured, TableRecording):
        return None, []
    with captured.lock:
        with _lock:
            filled = captured.launch(call.fill, call.reads)
        results: R = filled if call.launched is None else call.launched(filled)
        right, said = captured.guessed_right()
    return (results if right else None), said


def kept(device: torch.device, key: Hashable) -> Kept | None:
    """The recording of calls by table with a key, as it is kept, for `attempt_kept`; None if there is none."""
    cache = _caches.get(device)
    return None if cache is None else cache.kept(key)


def attempt_kept(
    of: Kept,
    fill: Callable[..., Any],
    about: tuple[Any, ...],
    reads: Tensors,
    launched: Callable[[Any], R],
) -> tuple[R | None, list[int]]:
    """`attempt_by_table` of a call about tensors on the current device, whose recording was found before.

    Args:
        of: That.
        fill: As that of a `TableCall`, with `about` behind the table and the new tensors.
        about: What it is given.
        reads: As those of a `TableCall`.
        launched: As that of a `TableCall`.
    """
    recording = of.recording
    if not isinstance(recording, TableRecording):
        return None, []
    with recording.lock:
        with _lock:
            filled = recording.launch(fill, reads, about)
            # While the device is at work.
            of.is_used()
        results = launched(filled)
        right, said = recording.guessed_right()
    return (results if right else None), said


def last_launch(device: torch.device) -> torch.cuda.Event | None:
    """Event after the last launch of a recording on a device, or a later one; None if there was none."""
    cache = _caches.get(device)
    return None if cache is None else cache.last_launch


def _find(device: torch.device, key: Hashable) -> Recording | None:
    cache = _caches.get(device)
    if cache is None:
        return None
    with _lock:
        return cache.find(key)


def note(call: Call) -> None:
    """Count a call whose work was done without it, to be recorded if such calls come often."""
    record(call)


def is_recorded(device: torch.device, key: Hashable) -> bool:
    """True if there is a recording of the calls with a key."""
    cache = _caches.get(device)
    return cache is not None and key in cache


def record(call: Call) -> None:
    """Count a call that was made without a recording: the third with its key is recorded."""
    with _lock:
        _cache_of(call.inputs[0].device).count(call.key, call.work, call.inputs)


def _cache_of(device: torch.device) -> GraphCache:
    found = _caches.get(device)
    if found is None:
        if not _caches:
            # Before torch and CUDA are taken apart.
            atexit.register(clear)
        most = torch.cuda.get_device_properties(device).total_memory // SHARE
        found = _caches[device] = GraphCache(most, recordings=MOST_RECORDINGS, of_many=MOST_OF_MANY)
    return found
