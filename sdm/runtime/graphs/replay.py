"""Calls that come again and again, recorded once and replayed: one launch instead of dozens.

A map takes about 60 launches, which take the host longer than a GPU needs to run many of them. So the third call of one
kind (the same grid, numbers of meshes, vertices, faces and boundary edges, on one device) is recorded as a CUDA graph,
and those that follow copy their tensors into the recording's, launch it and copy the result out. The values are the
same bits. Calls that want gradients, those inside `torch.compile` or another graph's capture, and results larger than
512 MiB are not recorded, nor is what a `MeshIndex` does.

A recording that has to go before it was used often makes later ones wait for more calls, so that many kinds by turns
cost little. Of each device the four recordings used last are kept, with at most a sixteenth of its memory; they share
their scratch, so the device runs one after the other, whatever streams they are launched on. `enable(False)`, or the
environment variable `SDM_REPLAY=0`, turns this off, `paused()` for a while; `clear()` gives the memory back.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import torch
from torch import Tensor
from torch.utils._python_dispatch import _get_current_dispatch_mode

from sdm.runtime.captured_call import Inputs, Say, Work, unheard
from sdm.runtime.graph_cache import CALLS, Shelf

__all__ = ["CALLS", "Say", "clear", "enable", "note", "paused", "replayed", "serves", "unheard"]

# The part of a device's memory that recordings may keep.
SHARE = 16

_switch = SimpleNamespace(on=os.environ.get("SDM_REPLAY", "1") != "0", pauses=0)
_turn = threading.RLock()
_shelves: dict[torch.device, Shelf] = {}


def enable(on: bool) -> None:
    """Whether calls are recorded and replayed; turning it off also does what `clear` does."""
    _switch.on = on
    if not on:
        clear()


@contextmanager
def paused() -> Iterator[None]:
    """Nothing is recorded or replayed meanwhile, by any thread; what is recorded stays."""
    with _turn:
        _switch.pauses += 1
    try:
        yield
    finally:
        with _turn:
            _switch.pauses -= 1


def clear() -> None:
    """Forget all recordings and counts: torch may then use their memory for other tensors, or give it back."""
    with _turn:
        for shelf in _shelves.values():
            shelf.forget()


def serves(tensor: Tensor) -> bool:
    """Whether a call with this tensor may be recorded and replayed."""
    if torch.compiler.is_compiling() or not (_switch.on and not _switch.pauses and tensor.is_cuda):
        return False
    # Tensors that only look like some, and modes that watch what happens to each, want to see every step.
    if type(tensor) not in (Tensor, torch.nn.Parameter) or _get_current_dispatch_mode() is not None:
        return False
    if tensor.requires_grad and torch.is_grad_enabled():
        return False
    if tensor.device.index == torch.cuda.current_device():
        return not torch.cuda.is_current_stream_capturing()
    with torch.cuda.device(tensor.device):
        return not torch.cuda.is_current_stream_capturing()


def replayed(kind: Hashable, inputs: Inputs) -> Inputs | None:
    """What a call gives, all of it new tensors; None if there is no recording, or a wrong guess was recorded."""
    shelf = _shelves.get(inputs[0].device)
    if shelf is None:
        return None
    with _turn:
        found = shelf.find(kind)
        if found is None:
            return None
    with found.turn:
        with _turn:
            results = found.launch(inputs)
        if found.guessed_right():
            return results
    with _turn:
        shelf.drop(kind)
    return None


def note(kind: Hashable, work: Work, inputs: Inputs) -> None:
    """Count a call without a recording: the third of a kind is recorded, as `work(say, *inputs)`.

    `work` queues kernels and does nothing else: it neither waits, nor remembers its inputs, nor looks at them. What it
    guessed about them it tells by a tensor of int32 given to `say`, in which zeros mean that the guess was right.
    """
    device = inputs[0].device
    with _turn:
        if device not in _shelves:
            if not _shelves:
                # Before torch and CUDA are taken apart.
                atexit.register(clear)
            _shelves[device] = Shelf(torch.cuda.get_device_properties(device).total_memory // SHARE)
        _shelves[device].note(kind, work, inputs)
