"""Launches that cost the host little, and use every core of a CPU: Warp itself runs a CPU launch on one thread."""
# pyright: basic

from __future__ import annotations

import ctypes
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import warp as wp

# Small launches cost less than waking the threads.
SMALLEST_SHARE = 256
SHARES_PER_THREAD = 8
# Warp loads a module twice if two threads want it at once, and takes back the one while it runs.
_loading = threading.RLock()


def _unlock() -> None:
    """A fork's copy of the lock may be held by a thread that the fork has not."""
    global _loading  # noqa: PLW0603
    _loading = threading.RLock()


os.register_at_fork(after_in_child=_unlock)


def threads() -> int:
    """Threads that CPU launches use: the cores this process may run on, or `SDM_NUM_THREADS`."""
    wanted = os.environ.get("SDM_NUM_THREADS", "")
    return max(1, int(wanted)) if wanted.isdigit() else len(os.sched_getaffinity(0))


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    # One pool for each process: threads do not survive a fork.
    return ThreadPoolExecutor(threads(), thread_name_prefix="sdm")


class _Recorded(threading.local):
    """The launches that a thread has recorded, one of each kernel, device and size of block.

    To fill in a recorded launch takes half the time of a new one. No two threads share any, as each fills in its own.
    """

    def __init__(self) -> None:
        self.known: dict[tuple[wp.Kernel, str, int], tuple[Any, list[tuple[Any, Any]]]] = {}


_recorded = _Recorded()


def _run(kernel: wp.Kernel, begin: int, count: int, inputs: list[Any], device: Any, block_dim: int) -> None:
    """`wp.launch` of the indices from `begin`."""
    key = kernel, device.alias, block_dim
    known = _recorded.known.get(key)
    values = [begin, *inputs]
    if known is None:
        with _loading:
            command: Any = wp.launch(kernel, count, values, device=device, block_dim=block_dim, record_cmd=True)
        # Warp's deterministic mode records something else, which is left alone.
        if type(command) is wp.Launch:
            # It would keep the arrays of this first launch alive.
            command.fwd_args = None
            types = [argument.type for argument in kernel.adj.args]
            _recorded.known[key] = command, [(wanted, getattr(wanted, "instance_type", None)) for wanted in types]
    else:
        command, types = known
        if len(values) != len(types):
            raise RuntimeError(f"{kernel.key} takes {len(types)} arguments, not {len(values)}")
        if command.bounds.size != count:
            command.set_dim(count)
        _fill(command, types, values)
    command.launch()


def _fill(command: Any, types: list[tuple[Any, Any]], values: list[Any]) -> None:
    """Put other values into a recorded launch, whose parameters have these types, and these types of structs."""
    params, addresses = command.params, command.params_addr
    place = 0
    for value, (wanted, struct) in zip(values, types, strict=True):
        # The first parameter is the launch's size.
        place += 1
        kind = type(value)
        if kind is int and wanted is wp.int32:
            # In place: nobody else has this number, and its address stays.
            params[place].value = value
            continue
        if kind is struct or (kind is wp.array and value.dtype is wanted.dtype and value.ndim == wanted.ndim):
            packed = value.__ctype__()
        else:
            # Whatever else there is, errors among it, is left to Warp.
            command.set_param_at_index(place - 1, value)
            continue
        if params[place] is packed:
            continue
        params[place] = packed
        if addresses:
            addresses[place] = ctypes.addressof(packed)


def launch(
    kernel: wp.Kernel, count: int, inputs: list[Any], device: Any, block_dim: int = 128, smallest: int = SMALLEST_SHARE
) -> None:
    """Run `kernel` for the indices 0 <= index < count, where index is `begin + wp.tid()`.

    Args:
        kernel: A kernel whose first parameter is `begin: int`.
        count: Number of indices.
        inputs: The other parameters.
        device: Warp device.
        block_dim: Threads of a block on a GPU.
        smallest: On a CPU, the fewest indices worth a turn of a thread.
    """
    if count <= 0:
        return
    device = device if type(device) is wp.Device else wp.get_device(device)
    if device.is_cuda:
        _run(kernel, 0, count, inputs, device, block_dim)
        return
    workers = threads()
    share = max(smallest, -(-count // (workers * SHARES_PER_THREAD)))
    if workers == 1 or count <= share:
        _run(kernel, 0, count, inputs, device, 1)
        return
    # Compiled and loaded before any thread wants it. A share of a kernel whose threads fetch their work may take all of
    # it, so none runs alone.
    with _loading:
        kernel.module.load(device, 1)

    def run(begin: int) -> None:
        _run(kernel, begin, min(share, count - begin), inputs, device, 1)

    list(_pool(os.getpid()).map(run, range(0, count, share)))


def set_array(struct: Any, name: str, array: wp.array) -> None:
    """Assign an array to a member of a Warp struct, whose type nobody checks.

    The members are set as Warp sets them for an array without gradients, in a fifth of the time.
    """
    struct.__dict__[name] = array
    setattr(struct.__ctype__(), name, array.__ctype__())


def launch_grid(kernel: wp.Kernel, dim: Any, **given: Any) -> None:
    """`wp.launch` of a kernel with `wp.tid()` of several dimensions; on a CPU by one thread at a time."""
    with _loading:
        wp.launch(kernel, dim=dim, **given)
