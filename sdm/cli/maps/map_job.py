"""The pipeline of `sdm compute` over some of its meshes: in this process, or a shard of what several devices do."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from typing import Any

from sdm.cli.maps.map_readers import READ, MapReaders, reading_processes
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.map_stages import MapStages
from sdm.cli.maps.map_told import Told, tell
from sdm.cli.maps.map_writers import map_writers, writing_processes
from sdm.cli.maps.work import MapTask, Written
from sdm.core.device import choose_device
from sdm.io.files.stand_in import StandIn, adopt
from sdm.runtime.pipeline.outcome import Done, Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_groups, in_threads, numbered
from sdm.runtime.pipeline.thread_count import readers_beside, writers_beside
from sdm.runtime.sharing.folder_job import FolderJob, ShardTold, require_seen
from sdm.runtime.worker_processes.pool import WorkerError, WorkerProcesses

# Meshes that a GPU gets in one call.
TOGETHER = 8


def maps_told(
    tasks: Iterable[tuple[int, MapTask]],
    count: int,
    settings: Settings,
    *,
    progress: Callable[[float], Any] = lambda _: None,
    alone: bool = False,
    single: bool = False,
    workers: int | None = None,
    writers: int = 0,
    reading: int = 0,
    times: StageTimes,
) -> Iterator[Told]:
    """Compute maps into their files, and tell of each, in the order of the tasks.

    Args:
        tasks: Numbers and files of meshes, asked for as there is room.
        count: How many there are at most.
        settings: What is the same for all.
        progress: Called with the share of a large map that is done.
        alone: An error is raised, and not told.
        single: The one mesh there is may have all of the machine.
        workers: Threads that read, and as many that write; by default what the machine has.
        writers: Processes that write in place of threads.
        reading: Processes that read in place of threads.
        times: The pipeline's clock.
    """
    readers, threads = (
        min(count, threads(settings.device) if workers is None else workers)
        for threads in (readers_beside, writers_beside)
    )
    most = TOGETHER if settings.device.type == "cuda" else 1
    with ExitStack() as stack:
        apart = None
        if reading:
            # A system that allows no more processes has threads. They are needed first.
            with suppress(OSError):
                apart = stack.enter_context(WorkerProcesses(READ, reading))
        beside = stack.enter_context(map_writers(writers, settings, 2 * writers + most)) if writers else None
        stages = MapStages(settings, progress, alone=single, writers=beside, readers=MapReaders(apart, settings.how))
        written = _written(tasks, count, settings, stages, readers, writers or threads, most, single, times)
        for number, task, outcome in stack.enter_context(closing(written)):
            if isinstance(outcome, Failed) and isinstance(outcome.error, WorkerError):
                raise outcome.error
            yield tell(outcome, number, task, settings, alone=alone)


def _written(
    tasks: Iterable[tuple[int, MapTask]],
    count: int,
    settings: Settings,
    stages: MapStages,
    readers: int,
    writers: int,
    most: int,
    single: bool,
    times: StageTimes,
) -> Generator[tuple[int, MapTask, Done[Written] | Failed], None, None]:
    """The pipeline: number, files and outcome of each mesh."""
    known: list[tuple[int, MapTask]] = []

    def noted() -> Iterator[MapTask]:
        for number, task in tasks:
            known.append((number, task))
            yield task

    read = in_threads(
        numbered(noted()),
        "read",
        stages.read,
        workers=readers,
        times=times,
        single=single,
        most_held=2 * max(readers, most),
    )
    measured = in_groups(read, str(settings.device), stages.measure, times=times, most=min(most, count))
    written = in_threads(
        measured,
        "write",
        stages.write,
        workers=writers,
        times=times,
        nbytes=lambda found: found.nbytes,
        prompt=True,
        single=single,
    )
    with closing(written):
        for outcome in written:
            yield *known[outcome.number], outcome


@dataclass(frozen=True, eq=False, kw_only=True)
class MapJob(FolderJob):
    """Maps of many meshes in shards, for several processes.

    Args:
        tasks: Files of all meshes.
        settings: What is the same for all; the device is each process's own.
        workers: As of `maps_told`.
        processes: That measure on each device.
        stand_ins: Paths that stand for addresses.
    """

    tasks: list[MapTask]
    settings: Settings
    workers: int | None = None
    processes: int = 1
    stand_ins: tuple[StandIn, ...] = ()

    def absolute(self) -> MapJob:
        """See `SharedJob`."""
        return replace(self, tasks=[task.absolute() for task in self.tasks])

    def check(self) -> None:
        """See `SharedJob`."""
        first = self.tasks[self.wanted[0]]
        require_seen(first.source, first.target.parent)

    def maker(self, device: str) -> Settings:
        """See `SharedJob`."""
        return replace(self.settings, device=choose_device(device))

    def run(
        self,
        shards: Iterable[int],
        maker: Settings,
        done: Callable[[ShardTold], None],
        *,
        times: StageTimes | None = None,
    ) -> None:
        """See `SharedJob`. Told are reports of shards, with what there is to tell of meshes in their order."""
        adopt(self.stand_ins)
        times = StageTimes() if times is None else times
        wanted = [self.tasks[number] for number in self.wanted]
        beside = {"writers": writing_processes(maker, wanted), "reading": reading_processes(maker, wanted)}
        more: dict[str, Any] = {name: count // self.processes for name, count in beside.items()}
        more |= {"workers": self.workers, "times": times}
        self.run_items(
            shards,
            lambda numbers: maps_told(((n, self.tasks[n]) for n in numbers), len(self.wanted), maker, **more),
            done,
            times,
        )
