"""`sdm compute` over its meshes: by one device or several, what is said about each, and what is left to say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.cli.common.failed_item import tell_failed
from sdm.cli.common.printed_line import print_line
from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.map_account import MapAccount
from sdm.cli.maps.map_job import MapJob, maps_told
from sdm.cli.maps.map_manifest import MapManifest
from sdm.cli.maps.map_readers import reading_processes
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.map_sharing import DEFAULT_RESOLUTION, processes_sharing
from sdm.cli.maps.map_told import tasks_of
from sdm.cli.maps.map_writers import writing_processes
from sdm.cli.maps.mesh_report import MeshEntry, failures_table, write_report
from sdm.io.files.leftovers import remove_leftovers_of
from sdm.io.files.stand_in import known
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.processes import OtherProcesses
from sdm.runtime.sharing.share_out import shard_size, share_out


def run(
    jobs: list[tuple[Path, Path]],
    settings: Settings,
    *,
    report: Path | None = None,
    skip_bad: bool = False,
    workers: int | None = None,
    times: StageTimes | None = None,
    devices: list[str] | None = None,
    processes: list[str] | None = None,
    ray: str | None = None,
    folder: Path | None = None,
    others: OtherProcesses | None = None,
) -> int | None:
    """Compute the map of each mesh into its file.

    Args:
        jobs: Pairs of a mesh file and the file to write.
        settings: What is the same for all.
        report: A JSON file about all meshes to write.
        skip_bad: Meshes that cannot be used are no failure of the whole.
        workers: Threads that read, and as many that write; by default what the machine has.
        times: The pipeline's clock, to be read afterwards, of the stages in this process.
        devices: Those of this machine that share the meshes if there are many; by default the settings' one alone.
        processes: The device of each process that takes part; by default as `processes_of` says of these devices.
        ray: Address of a Ray cluster whose devices share them.
        folder: Where maps go, if they go to a folder: its manifest says what is done until all is.
        others: Processes that have been started already, to be among those that take part.

    Returns:
        2 if some of several meshes failed, which is then said on stderr; None if none did, or they are to be skipped.
        A mesh that is alone raises its error.
    """
    times = StageTimes() if times is None else times
    tasks = tasks_of(jobs)
    with (
        MapManifest(folder if len(jobs) > 1 else None, settings, resume=settings.resume) as manifest,
        FileProgress(len(jobs), times) as progress,
    ):
        account = MapAccount(tasks, manifest, progress)
        wanted = account.wanted
        processes = processes_of(len(wanted), settings, devices) if processes is None else processes
        if others is not None:
            others.keep(len(processes) - 1 if wanted else 0)
        if wanted and (ray is not None or len(processes) > 1):
            size = shard_size(len(wanted), 0 if ray is not None else len(processes))
            each = 1 if ray is not None else len(processes) // len(set(processes))
            more: dict[str, Any] = {"workers": workers, "processes": each, "stand_ins": known()}
            job = MapJob(wanted=wanted, each=size, tasks=tasks, settings=settings, **more)
            share_out(job, job.shards, processes, ray, account.hear, times, others)
        elif wanted:
            account.hear(
                maps_told(
                    ((number, tasks[number]) for number in wanted),
                    len(wanted),
                    settings,
                    progress=progress.share,
                    alone=len(jobs) == 1 and not skip_bad,
                    single=len(jobs) == 1,
                    workers=workers,
                    writers=writing_processes(settings, [tasks[number] for number in wanted]),
                    reading=reading_processes(settings, [tasks[number] for number in wanted]),
                    times=times,
                )
            )
        if settings.resume and len(jobs) == 1:
            remove_leftovers_of(tasks[0].target)
        entries = account.end()
        if report is not None:
            write_report(entries, report, seconds_of_stages=times.seconds)
    return sum_up(entries, skip_bad)


def processes_of(meshes: int, settings: Settings, devices: list[str] | None) -> list[str]:
    """The device of each process that makes maps: see `processes_sharing`."""
    if devices is None:
        return [str(settings.device)]
    return processes_sharing(meshes, settings.voxels or DEFAULT_RESOLUTION**3, devices)


def sum_up(entries: list[MeshEntry], skip_bad: bool) -> int | None:
    """Say which meshes failed; the exit code."""
    failed = [entry for entry in entries if entry.state == "failed"]
    if skip_bad:
        for line in failures_table(entries):
            print_line(line)
        return None
    return tell_failed([(entry.mesh, entry.reason or "") for entry in failed], len(entries), "mesh", "meshes")
