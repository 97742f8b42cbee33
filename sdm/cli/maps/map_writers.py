"""Processes that write maps beside the one that measures them, in memory that they share."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.map_sharing import LARGEST_BESIDE
from sdm.cli.maps.work import MapTask
from sdm.io.files.stand_in import known
from sdm.io.maps.formats import format_of
from sdm.io.maps.save_and_load import WRITE
from sdm.runtime.host_copy import HostCopy
from sdm.runtime.pipeline.stages import MOST_BYTES
from sdm.runtime.pipeline.thread_count import threads_beside
from sdm.runtime.worker_processes.pool import WorkerProcesses
from sdm.runtime.worker_processes.rooms import SharedRooms
from sdm.runtime.worker_processes.shared_memory import can_share

T = TypeVar("T")
# What those functions are in that `WRITE` is given.
PACK = "sdm.io.files.nifti_stream"
# Processes that write for each two cores, as some wait for the disk
# (bench/decisions/0069-several-parts-of-a-shard.md).
WRITERS_OF_TWO = 3
# Cores and maps for which it is worth starting processes.
LEAST_CORES, LEAST_MAPS = 4, 32


class MapWriters:
    """Processes that write maps, and rooms that these are copied into.

    Args:
        workers: The processes.
        rooms: The rooms.
    """

    def __init__(self, workers: WorkerProcesses, rooms: SharedRooms) -> None:
        self.workers, self._rooms = workers, rooms
        self._give: weakref.WeakKeyDictionary[HostCopy[Any], Callable[[], Any]] = weakref.WeakKeyDictionary()

    def host_copy(self, values: Tensor, make: Callable[[Tensor], T]) -> HostCopy[T]:
        """Values on their way to a room, if they find place in one; it is free again when the copy is let go of.

        Whoever is done with it before says so by `free`: an error keeps what it was raised about.
        """
        if values.nbytes > self._rooms.size:
            return HostCopy(values, make)
        room = self._rooms.take()
        found = HostCopy(values, make, memory=room.content)
        give = weakref.finalize(found, self._rooms.give, room)
        give.atexit = False
        self._give[found] = give
        return found

    def free(self, copy: HostCopy[Any]) -> None:
        """Give back the room of a copy that nobody reads any more."""
        give = self._give.get(copy)
        if give is not None:
            give()


@contextmanager
def map_writers(count: int, settings: Settings, most: int) -> Iterator[MapWriters]:
    """So many processes that write, and rooms for the maps of a pipeline.

    Args:
        count: Of processes.
        settings: Of all maps.
        most: Maps that are on their way at most.
    """
    size = _bytes_of_map(settings)
    several = max(count, min(most, MOST_BYTES // size))
    with (
        SharedRooms(several, size, settings.device) as rooms,
        WorkerProcesses(WRITE, count, shared=rooms.all, imports=[PACK]) as workers,
    ):
        yield MapWriters(workers, rooms)


def writing_processes(settings: Settings, tasks: Sequence[MapTask]) -> int:
    """Number of processes that are to write the maps of these meshes; 0 where threads do it.

    Args:
        settings: Of all maps.
        tasks: The meshes.
    """
    # At an address, maps go through this process.
    if not processes_pay(settings, tasks) or any(one.written for one in known()):
        return 0
    fits = settings.band is None and 0 < _bytes_of_map(settings) <= LARGEST_BESIDE
    alone = fits and format_of(tasks[0].target).alone
    return WRITERS_OF_TWO * threads_beside(settings.device) // 2 if alone else 0


def processes_pay(settings: Settings, tasks: Sequence[MapTask]) -> bool:
    """True where processes beside the one that measures help: a GPU, cores and meshes enough, and memory to share."""
    cores = threads_beside(settings.device)
    return settings.device.type == "cuda" and cores >= LEAST_CORES and len(tasks) >= LEAST_MAPS and can_share()


def _bytes_of_map(settings: Settings) -> int:
    """Bytes of each map; 0 where they differ from mesh to mesh."""
    return (settings.voxels or 0) * np.dtype(settings.dtype).itemsize
