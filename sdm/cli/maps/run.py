"""`sdm compute` over its meshes: by one device or several, what is said about each, and what is left to say."""

from __future__ import annotations

import sys
from pathlib import Path

from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.map_account import MapAccount
from sdm.cli.maps.map_job import MapJob, maps_told
from sdm.cli.maps.map_manifest import MapManifest
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.map_told import tasks_of
from sdm.cli.maps.mesh_report import MeshEntry, failures_table, write_report
from sdm.io.files.stand_in import known
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.share_out import is_shared, shard_size, share_out


def run(
    jobs: list[tuple[Path, Path]],
    settings: Settings,
    *,
    report: Path | None = None,
    skip_bad: bool = False,
    workers: int | None = None,
    times: StageTimes | None = None,
    devices: list[str] | None = None,
    ray: str | None = None,
    folder: Path | None = None,
) -> int | None:
    """Compute the map of each mesh into its file.

    Args:
        jobs: Pairs of a mesh file and the file to write.
        settings: What is the same for all.
        report: A JSON file about all meshes to write.
        skip_bad: Meshes that cannot be used are no failure of the whole.
        workers: Threads that read, and as many that write; by default what the machine has.
        times: The pipeline's clock, to be read afterwards, of the stages in this process.
        devices: Several of this machine that share the meshes, in a process each; by default the settings' one.
        ray: Address of a Ray cluster whose devices share them.
        folder: Where maps go, if they go to a folder: its manifest says what is done until all is.

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
        if is_shared(len(wanted), devices, ray):
            size = shard_size(len(wanted), 0 if devices is None else len(devices))
            job = MapJob(wanted=wanted, each=size, tasks=tasks, settings=settings, workers=workers, stand_ins=known())
            share_out(job, job.shards, devices or [], ray, account.hear)
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
                    times=times,
                )
            )
        entries = account.end()
        if report is not None:
            write_report(entries, report, seconds_of_stages=times.seconds)
    return sum_up(entries, skip_bad)


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
