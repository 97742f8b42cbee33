"""The pipeline of `sdm watertight` over some of its meshes: in this process, or a shard of what several devices do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from sdm.cli.common.failed_item import reason_of
from sdm.cli.surfaces.closing_stages import Closed, Closing, ClosingStages
from sdm.cli.surfaces.journal import Journal
from sdm.core.device import choose_device
from sdm.io.files.stand_in import StandIn, adopt
from sdm.remeshing import WatertightReport
from sdm.runtime.pipeline.outcome import Done, Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_threads, numbered, one_by_one
from sdm.runtime.pipeline.thread_count import threads_beside
from sdm.runtime.sharing.folder_job import FolderJob, ShardTold, require_seen

Job = tuple[Path, Path]


@dataclass(frozen=True, kw_only=True)
class SurfaceTold:
    """Report of one mesh.

    Args:
        number: Of the mesh.
        reason: Of one that failed, the sentence about it.
        name: Of the mesh.
        triangles: It has.
        digest: Of what its surface is made from.
        report: About the surface; None of one that was there already.
        known: What was told of one that was there already.
        seconds: That it took in all stages.
    """

    number: int
    reason: str | None = None
    name: str = ""
    triangles: int = 0
    digest: str = ""
    report: WatertightReport | None = None
    known: dict[str, Any] | None = None
    seconds: float = 0.0


def surfaces_told(
    jobs: Iterable[tuple[int, Job]],
    count: int,
    options: Closing,
    journal: Journal,
    times: StageTimes,
    *,
    single: bool = False,
    alone: bool = False,
) -> Iterator[SurfaceTold]:
    """Close meshes into their files, and tell of each, in the order of the jobs.

    Args:
        jobs: Numbers and files of meshes.
        count: How many there are at most.
        options: What is the same for all.
        journal: Knows which surfaces are there.
        times: The pipeline's clock.
        single: The one mesh there is may have all of the machine.
        alone: An error is raised, and not told.
    """
    device = choose_device(options.device)
    stages, threads = ClosingStages(options, journal), min(threads_beside(device), count)
    begun: list[int] = []

    def noted() -> Iterator[Job]:
        for number, job in jobs:
            begun.append(number)
            yield job

    read = in_threads(numbered(noted()), "read", stages.read, workers=threads, times=times, single=single)
    closed = one_by_one(read, str(device), stages.close, times=times)
    written = in_threads(
        closed,
        "write",
        stages.write,
        workers=threads,
        times=times,
        nbytes=lambda one: one.nbytes,
        prompt=True,
        single=single,
    )
    for outcome in written:
        yield _told(outcome, begun[outcome.number], alone=alone)


def _told(outcome: Done[Closed] | Failed, number: int, *, alone: bool) -> SurfaceTold:
    if isinstance(outcome, Failed):
        return SurfaceTold(number=number, reason=reason_of(outcome, alone=alone))
    made = outcome.value
    return SurfaceTold(
        number=number,
        name=made.read.mesh.name,
        triangles=len(made.read.mesh),
        digest=made.read.digest,
        report=made.report,
        known=made.read.known,
        seconds=made.seconds,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class ClosingJob(FolderJob):
    """Surfaces of many meshes in shards, for several processes.

    Args:
        jobs: Files of all meshes.
        options: What is the same for all; the device is each process's own.
        folder: Where surfaces go.
        report: Of a run that came to its end.
        resume: Leave surfaces that are there already.
        stand_ins: Paths that stand for addresses.
    """

    jobs: list[Job]
    options: Closing
    folder: Path | None
    report: Path | None
    resume: bool
    stand_ins: tuple[StandIn, ...] = ()

    def absolute(self) -> ClosingJob:
        """See `SharedJob`."""
        jobs = [(source.absolute(), target.absolute()) for source, target in self.jobs]
        folder, report = (None if path is None else path.absolute() for path in (self.folder, self.report))
        return replace(self, jobs=jobs, folder=folder, report=report)

    def check(self) -> None:
        """See `SharedJob`."""
        source, target = self.jobs[self.wanted[0]]
        require_seen(source, target.parent)

    def maker(self, device: str | torch.device) -> tuple[Closing, Journal]:
        """See `SharedJob`. The journal is read alone: who shares the work out keeps it."""
        adopt(self.stand_ins)
        kept = (self.folder, self.report) if self.resume else (None, None)
        return replace(self.options, device=str(choose_device(device))), Journal(*kept, resume=self.resume)

    def run(
        self,
        shards: Iterable[int],
        maker: tuple[Closing, Journal],
        done: Callable[[ShardTold], None],
        *,
        times: StageTimes | None = None,
    ) -> None:
        """See `SharedJob`. Told are reports of shards, with those of their meshes in their order."""
        times = StageTimes() if times is None else times
        self.run_items(
            shards,
            lambda numbers: surfaces_told(((n, self.jobs[n]) for n in numbers), len(self.wanted), *maker, times),
            done,
            times,
        )
