"""`sdm compute` over its meshes: the stages put together, what is said about each, and what is left to say."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from sdm.cli.common.error_sentence import sentence_of
from sdm.cli.common.full_disk import is_full_disk
from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.map_stages import MapStages
from sdm.cli.maps.mesh_report import MeshEntry, failures_table, write_report
from sdm.cli.maps.work import MapTask, Written
from sdm.errors import FormatError
from sdm.io.files.stand_in import shown
from sdm.runtime.pipeline.outcome import Done, Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_groups, in_threads, numbered
from sdm.runtime.pipeline.thread_count import readers_beside, writers_beside

# Meshes that a GPU gets in one call.
TOGETHER = 8


def run(
    jobs: list[tuple[Path, Path]],
    settings: Settings,
    *,
    report: Path | None = None,
    skip_bad: bool = False,
    workers: int | None = None,
    times: StageTimes | None = None,
) -> int | None:
    """Compute the map of each mesh into its file.

    Args:
        jobs: Pairs of a mesh file and the file to write.
        settings: What is the same for all.
        report: A JSON file about all meshes to write.
        skip_bad: Meshes that cannot be used are no failure of the whole.
        workers: Threads that read, and as many that write; by default what the machine has.
        times: The pipeline's clock, to be read afterwards.

    Returns:
        2 if some of several meshes failed, which is then said on stderr; None if none did, or they are to be skipped.
        A mesh that is alone raises its error.
    """
    times = StageTimes() if times is None else times
    readers, writers = (
        min(len(jobs), threads(settings.device) if workers is None else workers)
        for threads in (readers_beside, writers_beside)
    )
    most = TOGETHER if settings.device.type == "cuda" else 1
    entries: list[MeshEntry] = []
    names = _names([source for source, _ in jobs])
    with FileProgress(len(jobs), times) as progress:
        stages = MapStages(settings, progress.share, alone=len(jobs) == 1)
        tasks = numbered(MapTask(*job) for job in jobs)
        read = in_threads(
            tasks,
            "read",
            stages.read,
            workers=readers,
            times=times,
            single=len(jobs) == 1,
            most_held=2 * max(readers, most),
        )
        measured = in_groups(read, str(settings.device), stages.measure, times=times, most=min(most, len(jobs)))
        written = in_threads(
            measured,
            "write",
            stages.write,
            workers=writers,
            times=times,
            nbytes=lambda found: found.nbytes,
            prompt=True,
            single=len(jobs) == 1,
        )
        progress.begin(names[0])
        for outcome in written:
            source, target = jobs[outcome.number]
            entries.append(_entry(outcome, source, target, settings, alone=len(jobs) == 1 and not skip_bad))
            if isinstance(outcome, Done):
                _tell(names[outcome.number], outcome.value, settings, progress)
            progress.end()
            if outcome.number + 1 < len(jobs):
                progress.begin(names[outcome.number + 1])
    if report is not None:
        write_report(entries, report, seconds_of_stages=times.seconds)
    return sum_up(entries, skip_bad)


def _entry(
    outcome: Done[Written] | Failed, source: Path, target: Path, settings: Settings, *, alone: bool
) -> MeshEntry:
    if isinstance(outcome, Failed):
        sentence = sentence_of(outcome.error)
        if sentence is None or alone:
            raise outcome.error
        if is_full_disk(outcome.error):
            raise FormatError(f"{sentence}; --resume goes on from there") from outcome.error
        return MeshEntry(mesh=shown(source), state="failed", reason=sentence)
    found = outcome.value
    mesh = found.read.measured
    return MeshEntry(
        mesh=shown(source),
        state="there already" if found.read.there else "done",
        output=shown(target),
        triangles=len(mesh),
        closed=found.closed,
        sign=settings.sign,
        inside=found.inside,
        ambiguous_voxels=found.ambiguous if settings.sign == "winding" else None,
        warnings=[line.lstrip(": ") for line in found.warnings],
        seconds=None if found.read.there else round(found.seconds, 4),
    )


def _names(sources: list[Path]) -> list[str]:
    """Paths of meshes below the folder that is common to all, as lines name them."""
    common = os.path.commonpath([source.parent.absolute() for source in sources])
    return [source.absolute().relative_to(common).as_posix() for source in sources]


def _tell(name: str, found: Written, settings: Settings, progress: FileProgress) -> None:
    read, grid = found.read, found.read.grid
    if read.there:
        progress.print(f"{name}: {shown(read.task.target)} is there already")
        return
    spacing = " x ".join(f"{s:.4g}" for s in (grid.spacing[:1] if len(set(grid.spacing)) == 1 else grid.spacing))
    progress.print(
        f"{name}: {len(read.mesh):,} triangles, {' x '.join(map(str, grid.shape))} voxels of {spacing}, "
        f"{found.seconds:.2f} s on {settings.device}, written to {shown(read.task.target)}"
    )
    for warning in found.warnings:
        progress.print(f"sdm: warning: {name}{warning}", warn=True)


def sum_up(entries: list[MeshEntry], skip_bad: bool) -> int | None:
    """Say which meshes failed; the exit code."""
    failed = [entry for entry in entries if entry.state == "failed"]
    if skip_bad:
        for line in failures_table(entries):
            print(line)
        return None
    for entry in failed:
        # Most sentences name the file already.
        named = entry.reason if entry.mesh in (entry.reason or "") else f"{entry.mesh}: {entry.reason}"
        print(f"sdm: {named}", file=sys.stderr)
    if failed:
        print(f"sdm: {len(failed)} of {len(entries)} meshes failed; the others are done", file=sys.stderr)
    return 2 if failed else None
