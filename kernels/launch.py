"""Launches that cost the host little, and use every core of a CPU: Warp itself runs a CPU launch on one thread."""
# pyright: basic

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import Any

import warp as wp

from sdm.kernels.launches import recorded
from sdm.kernels.launches.compiling import noticed
from sdm.kernels.launches.recorded import run

# Small launches cost less than waking the threads.
SMALLEST_SHARE = 256
SHARES_PER_THREAD = 8
# Of a kernel that takes some ten nanoseconds for each index, the fewest that are worth a turn of a thread; and of one
# that takes some hundred.
LIGHT_SHARE, CURVE_SHARE = 4096, 1024
# Modules that a CPU has run.
_loaded: set[wp.Module] = set()


class _Sharing(threading.local):
    is_off: bool = False


_sharing = _Sharing()


@contextmanager
def by_this_thread() -> Iterator[None]:
    """CPU launches of the block are run by the thread that asks for them, and by no other.

    For threads that work beside each other, each on something of its own: shares of all of them in one queue would be
    hundreds for a mesh, and each hands Python's lock on twice.
    """
    before, _sharing.is_off = _sharing.is_off, True
    try:
        yield
    finally:
        _sharing.is_off = before


def threads() -> int:
    """Threads that CPU launches use: the cores this process may run on, or `SDM_NUM_THREADS`."""
    wanted = os.environ.get("SDM_NUM_THREADS", "")
    return max(1, int(wanted)) if wanted.isdigit() else cores()


def cores() -> int:
    """Cores that this process may run on; systems other than Linux tell how many there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    # One pool for each process: threads do not survive a fork.
    return ThreadPoolExecutor(threads(), thread_name_prefix="sdm")


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
        run(kernel, count, [0, *inputs], device, block_dim)
        return
    # Before anybody asks how many cores there are.
    workers = 1 if _sharing.is_off or count <= smallest else threads()
    share = max(smallest, -(-count // (workers * SHARES_PER_THREAD)))
    if workers == 1 or count <= share:
        run(kernel, count, [0, *inputs], device, 1)
        return
    # Compiled and loaded before any thread wants it. A share of a kernel whose threads fetch their work may take all of
    # it, so none runs alone.
    with recorded.loading:
        if kernel.module in _loaded:
            kernel.module.load(device, 1)
        else:
            with noticed(device.alias):
                kernel.module.load(device, 1)
            _loaded.add(kernel.module)

    # The thread that asks works too: where the others wake up late it has done everything, and waits for nobody.
    begins = deque(range(0, count, share))

    def work() -> None:
        while True:
            try:
                begin = begins.popleft()
            except IndexError:
                return
            run(kernel, min(share, count - begin), [begin, *inputs], device, 1)

    helpers: list[Future[None]] = []
    try:
        for _ in range(min(workers, len(begins)) - 1):
            helpers.append(_pool(os.getpid()).submit(work))
        work()
        for helper in helpers:
            if not helper.cancel():
                helper.result()
    except BaseException:
        # An interrupt too: the caller lets go of memory that other threads still work on.
        begins.clear()
        for helper in helpers:
            helper.cancel()
        wait(helpers)
        raise


def provide_zeros(empty: Any, zeros: wp.array) -> None:
    """Let `new_zeros` of an allocator take them from (n,) int32 that are zero once kernels run."""
    empty.zeros, empty.taken = zeros, 0


def new_zeros(empty: Any, length: int) -> wp.array:
    """(length,) int32 zeros from an allocator of workspace, without a launch where it has some."""
    zeros = getattr(empty, "zeros", None)
    if zeros is None or empty.taken + length > zeros.shape[0]:
        made = empty(length, wp.int32)
        made.zero_()
        return made
    begin = empty.taken
    empty.taken += length
    return zeros[begin : begin + length]


def set_array(struct: Any, name: str, array: wp.array) -> None:
    """Assign an array to a member of a Warp struct, whose type nobody checks.

    The members are set as Warp sets them for an array without gradients, in a fifth of the time.
    """
    struct.__dict__[name] = array
    setattr(struct.__ctype__(), name, array.__ctype__())


def set_number(struct: Any, name: str, number: int) -> None:
    """Assign a whole number to a member of a Warp struct, whose type nobody checks."""
    struct.__dict__[name] = number
    setattr(struct.__ctype__(), name, number)


def launch_grid(kernel: wp.Kernel, dim: Any, **given: Any) -> None:
    """`wp.launch` of a kernel with `wp.tid()` of several dimensions; on a CPU by one thread at a time."""
    with recorded.loading:
        wp.launch(kernel, dim=dim, **given)
