"""Ways to write shards while the next are made: by threads of this process, or by processes that do nothing else.

What limits threads that compress, hash and write beside each other is Python's lock. On a GPU's host with many cores
small processes do it, each with a lock of its own, and maps are copied from the GPU into memory that they share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from sdm.dataset.shard_writer import write_shard
from sdm.runtime.host_copy import HostRows
from sdm.runtime.pipeline.thread_count import threads_beside
from sdm.runtime.worker_processes.pool import WorkerProcesses
from sdm.runtime.worker_processes.rooms import SharedRooms
from sdm.runtime.worker_processes.shared_memory import SharedMemory, can_share

# Shards that threads compress and write at a time; each is 256 MiB of memory, if nobody says otherwise. A thread
# takes 0.5 to 1 ms for the SHA-256 of a megabyte.
THREADS = 6
# Processes, and cores that each has: one compresses while another hashes, gathers and writes.
PROCESSES, CORES = 8, 2
# Shards that a process writes at a time: while it waits for flushes of one, the disk would have nothing of it. Those of
# all processes end together, as a commit of the file system's journal ends them.
CALLS = 2
# Shards of a GPU that are made while all writers are busy, so that none of them waits for the next one.
READY = 2


class Shard(NamedTuple):
    """A shard on its way to the disk.

    Args:
        number: Of the dataset's shards.
        theta: (n,P) parameters.
        transform: (n,4,4), for families that place meshes.
        maps: (n,nx,ny,nz).
        memory: Where they are, if it is shared.
    """

    number: int
    theta: np.ndarray
    transform: np.ndarray | None
    maps: HostRows
    memory: SharedMemory | None


@dataclass(frozen=True)
class ShardWriters:
    """Writers of shards.

    Args:
        count: Shards that are written at a time.
        held: Shards that there is room for, with those that are made.
        memory: Memory for the maps of the next shard; None if any will do.
        write: Writes a shard, from any thread.
    """

    count: int
    held: int
    memory: Callable[[], SharedMemory | None]
    write: Callable[[Shard], None]


def shard_writers(
    folder: Path, manifest: dict[str, Any], scratch: Path, device: torch.device, *, shards: int, local: bool
) -> AbstractContextManager[ShardWriters]:
    """Writers for a process that makes shards on a device.

    Args:
        folder: The dataset.
        manifest: Its manifest.
        scratch: A folder on the same disk that nobody else uses.
        device: Where maps are made.
        shards: How many there are at least.
        local: False where the dataset stands for one at an address.
    """
    threads = threads_beside(device)
    several = device.type == "cuda" and local and can_share() and threads >= 2 * CORES
    if several and shards > THREADS:
        return process_writers(folder, manifest, scratch, device, count=min(PROCESSES, threads // CORES))
    return thread_writers(folder, manifest, scratch, device)


@contextmanager
def thread_writers(
    folder: Path, manifest: dict[str, Any], scratch: Path, device: torch.device
) -> Iterator[ShardWriters]:
    """Writers that are threads of whoever calls `write`."""
    threads = threads_beside(device)
    count = min(threads, THREADS)
    with ThreadPoolExecutor(threads, thread_name_prefix="sdm-compress") as pool:

        def write(shard: Shard) -> None:
            maps = shard.maps.wait()
            write_shard(folder, manifest, shard.number, shard.theta, shard.transform, maps, scratch, pool)

        yield ShardWriters(count, count + (READY if device.type == "cuda" else 0), lambda: None, write)


@contextmanager
def process_writers(
    folder: Path, manifest: dict[str, Any], scratch: Path, device: torch.device, *, count: int
) -> Iterator[ShardWriters]:
    """Writers that are processes of their own."""
    dtype, shape = np.dtype(manifest["recipe"]["dtype"]), manifest["recipe"]["grid"]["shape"]
    size = manifest["shard"] * math.prod(shape) * dtype.itemsize
    # As many as there is memory for: of each process one that is on its way to the disk, of half of them another one.
    several = count + count // 2
    with (
        SharedRooms(several, size, device) as rooms,
        WorkerProcesses("sdm.dataset.shard_writer:write_alone", count, calls=CALLS, shared=rooms.all) as workers,
    ):

        def write(shard: Shard) -> None:
            try:
                maps = shard.maps.wait()
                workers.call(folder, manifest, shard.number, shard.theta, shard.transform, maps, scratch, CORES)
            finally:
                # Of one that failed too, or whoever makes the next would wait for it.
                if shard.memory is not None:
                    rooms.give(shard.memory)

        # Those that are written wait for one before them, which takes no memory.
        yield ShardWriters(several, 2 * several, rooms.take, write)
