"""Launches that use every core of a CPU: Warp itself runs a CPU launch on one thread."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import warp as wp

# Small launches cost less than waking the threads.
SMALLEST_SHARE = 256
SHARES_PER_THREAD = 8


def threads() -> int:
    """Threads that CPU launches use: the cores this process may run on, or `SDM_NUM_THREADS`."""
    wanted = os.environ.get("SDM_NUM_THREADS", "")
    return max(1, int(wanted)) if wanted.isdigit() else len(os.sched_getaffinity(0))


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
    device = wp.get_device(device)
    if device.is_cuda:
        wp.launch(kernel, dim=count, inputs=[0, *inputs], device=device, block_dim=block_dim)
        return
    workers = threads()
    share = max(smallest, -(-count // (workers * SHARES_PER_THREAD)))
    if workers == 1 or count <= share:
        wp.launch(kernel, dim=count, inputs=[0, *inputs], device=device)
        return
    # The first share compiles and loads the module while no other thread wants it.
    wp.launch(kernel, dim=share, inputs=[0, *inputs], device=device)

    def run(begin: int) -> None:
        wp.launch(kernel, dim=min(share, count - begin), inputs=[begin, *inputs], device=device)

    list(_pool(os.getpid()).map(run, range(share, count, share)))
