"""`sdm watertight` over its meshes: where surfaces go, what is said about each, and what is left to say."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sdm.cli.common.inputs import refuse_inputs, refuse_twice
from sdm.cli.common.output_files import inputs_of, places_in, without_outputs
from sdm.cli.common.printed_line import counted
from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.mesh_report import MeshEntry, write_report
from sdm.cli.maps.run import sum_up
from sdm.cli.surfaces.closing_job import ClosingJob, SurfaceTold, surfaces_told
from sdm.cli.surfaces.closing_stages import Closing
from sdm.cli.surfaces.journal import Journal
from sdm.core.device import choose_device
from sdm.errors import FormatError, MeshError
from sdm.io.files.leftovers import remove_leftovers, remove_leftovers_of
from sdm.io.files.stand_in import known, shown
from sdm.io.maps.formats import check_file
from sdm.io.meshes.write import WRITERS, ending_to_write
from sdm.remeshing import WatertightReport
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.process_count import processes_for
from sdm.runtime.sharing.share_out import share_out

DEFAULT_ENDING = "ply"
# Meshes of a shard, each of which takes long. About what one takes of a GPU and its host.
SHARD, SECONDS_AT_512 = 4, 0.5


def targets_of(meshes: list[Path], out: Path, ending: str | None) -> tuple[list[tuple[Path, Path]], bool]:
    """Pairs of a mesh file and the file to write, and whether they lie in a folder, which is made.

    Raises:
        MeshError: No mesh at all.
        FormatError: Several surfaces for one file, another format than that of the file, or one to write over a mesh.
    """
    sources = without_outputs(inputs_of(meshes), meshes, out)
    if not sources:
        where = f"was found in {', '.join(map(str, meshes))}" if meshes else "was given"
        raise MeshError(f"no mesh {where}: name one or more mesh files, or a folder of them")
    one = len(meshes) == 1 and not meshes[0].is_dir()
    if out.suffix.lower().removeprefix(".") in WRITERS and not out.is_dir():
        if not one:
            raise FormatError(f"several meshes need a folder to write to, and {out} ends like one mesh")
        if ending not in (None, ending_to_write(out)):
            raise FormatError(f"{out} does not end with .{ending}, which --format asks for")
        jobs = [(next(iter(sources)), out)]
    else:
        if one and out.suffix and not out.is_dir():
            ending_to_write(out)
        places = places_in(sources)
        names = [out / place.with_name(f"{place.name}.{ending or DEFAULT_ENDING}") for place in places]
        jobs = list(zip(sources, names, strict=True))
    refuse_inputs((target for _, target in jobs), sources)
    for folder in dict.fromkeys(target.parent for _, target in jobs):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FormatError(f"the folder {folder} cannot be made: {error.strerror or error}") from error
    return jobs, jobs[0][1] != out


def run(
    jobs: list[tuple[Path, Path]],
    options: Closing,
    *,
    report: Path | None = None,
    skip_bad: bool = False,
    folder: Path | None = None,
    resume: bool = False,
    devices: list[str] | None = None,
    ray: str | None = None,
) -> int | None:
    """Close each mesh into its file; 2 if some failed and are not to be skipped. One alone raises its error.

    Args:
        jobs: Pairs of a mesh file and the file to write.
        options: What is the same for all.
        report: A JSON file about all meshes to write.
        skip_bad: Meshes that cannot be used are no failure of the whole.
        folder: Where surfaces go, if they go to a folder: what is finished is kept there until the report is written.
        resume: Leave surfaces that are there already, made from the same mesh in the same way.
        devices: Those of this machine that share the meshes if there are many; by default the options' one alone.
        ray: Address of a Ray cluster whose devices share them.
    """
    if report is not None:
        refuse_inputs([report], (source for source, _ in jobs))
        refuse_twice(report, (target for _, target in jobs))
        check_file(report)
    journal, times = Journal(folder, report, resume=resume), StageTimes()
    entries: list[MeshEntry] = []
    found: dict[str, dict[str, Any]] = {}
    processes = processes_of(len(jobs), options, devices)
    with FileProgress(len(jobs), times) as progress:
        progress.begin(jobs[0][0].name)

        def hear(several: Iterable[SurfaceTold]) -> None:
            for told in several:
                source, target = jobs[told.number]
                if told.reason is not None:
                    entries.append(MeshEntry(mesh=shown(source), state="failed", reason=told.reason))
                else:
                    found[shown(source)] = _kept(told, target, journal, progress)
                    entries.append(_entry(source, target, told, found[shown(source)]))
                progress.end()
                if len(entries) < len(jobs):
                    progress.begin(jobs[len(entries)][0].name)

        if ray is not None or len(processes) > 1:
            job = ClosingJob(
                wanted=list(range(len(jobs))),
                each=SHARD,
                jobs=jobs,
                options=options,
                folder=folder,
                report=report,
                resume=resume,
                stand_ins=known(),
            )
            share_out(job, job.shards, processes, ray, hear, times)
        else:
            more = {"single": len(jobs) == 1, "alone": len(jobs) == 1 and not skip_bad}
            hear(surfaces_told(enumerate(jobs), len(jobs), options, journal, times, **more))
    if resume and folder is not None:
        remove_leftovers(folder)
    elif folder is None:
        remove_leftovers_of(jobs[0][1])
    if report is not None:
        write_report(entries, report, surfaces=found, seconds_of_stages=times.seconds)
        journal.close()
    return sum_up(entries, skip_bad)


def processes_of(meshes: int, options: Closing, devices: list[str] | None) -> list[str]:
    """The device of each process: one on each GPU where the work takes long."""
    if devices is None or meshes < 2:
        return [str(choose_device(options.device))]
    return processes_for(devices, meshes * SECONDS_AT_512 * (options.resolution / 512) ** 2, several=False)


def _kept(told: SurfaceTold, target: Path, journal: Journal, progress: FileProgress) -> dict[str, Any]:
    """The report's part about a surface, which is kept and printed."""
    if told.report is None:
        progress.print(f"{told.name}: {shown(target)} is there already")
        return told.known or {}
    progress.print(_line(told.report, told.seconds, target))
    return journal.add(target, told.digest, told.report.as_dict())


def _entry(source: Path, target: Path, told: SurfaceTold, kept: dict[str, Any]) -> MeshEntry:
    return MeshEntry(
        mesh=shown(source),
        state="there already" if told.report is None else "done",
        output=shown(target),
        triangles=told.triangles,
        closed=kept.get("closed"),
        sign=kept.get("sign"),
        seconds=None if told.report is None else round(told.seconds, 4),
    )


def _line(made: WatertightReport, seconds: float, target: Path) -> str:
    forth, back = made.input_to_output, made.output_to_input
    return (
        f"{made.name}: {counted(made.triangles, 'triangle')}, {'closed' if made.closed else 'not closed'}; "
        f"{made.output_triangles:,} at an offset of {made.offset:.4g} by voxels of {made.spacing:.4g}; "
        f"mesh to surface at most {forth.largest:.4g}, on average {forth.mean:.4g}; "
        f"surface to mesh {back.largest:.4g}, {back.mean:.4g}; {seconds:.2f} s, written to {shown(target)}"
    )
