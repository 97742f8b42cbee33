"""`sdm watertight` over its meshes: where surfaces go, what is said about each, and what is left to say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.cli.common.error_sentence import sentence_of
from sdm.cli.common.full_disk import is_full_disk
from sdm.cli.common.inputs import refuse_inputs
from sdm.cli.common.output_files import inputs_of, places_in
from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.mesh_report import MeshEntry, write_report
from sdm.cli.maps.run import sum_up
from sdm.cli.surfaces.closing_stages import Closed, Closing, ClosingStages
from sdm.cli.surfaces.journal import Journal
from sdm.core.device import choose_device
from sdm.errors import FormatError, MeshError
from sdm.io.files.stand_in import shown
from sdm.io.meshes.write import WRITERS, ending_to_write
from sdm.remeshing import WatertightReport
from sdm.runtime.pipeline.outcome import Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_threads, numbered, one_by_one
from sdm.runtime.pipeline.thread_count import threads_beside

DEFAULT_ENDING = "ply"


def targets_of(meshes: list[Path], out: Path, ending: str | None) -> tuple[list[tuple[Path, Path]], bool]:
    """Pairs of a mesh file and the file to write, and whether they lie in a folder, which is made.

    Raises:
        MeshError: No mesh at all.
        FormatError: Several surfaces for one file, another format than that of the file, or one to write over a mesh.
    """
    sources = inputs_of(meshes)
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
) -> int | None:
    """Close each mesh into its file; 2 if some failed and are not to be skipped. One alone raises its error.

    Args:
        jobs: Pairs of a mesh file and the file to write.
        options: What is the same for all.
        report: A JSON file about all meshes to write.
        skip_bad: Meshes that cannot be used are no failure of the whole.
        folder: Where surfaces go, if they go to a folder: what is finished is kept there until the report is written.
        resume: Leave surfaces that are there already, made from the same mesh in the same way.
    """
    device = choose_device(options.device)
    if report is not None:
        refuse_inputs([report], (source for source, _ in jobs))
    journal, times = Journal(folder, report, resume=resume), StageTimes()
    stages, threads = ClosingStages(options, journal), min(threads_beside(device), len(jobs))
    entries: list[MeshEntry] = []
    found: dict[str, dict[str, Any]] = {}
    alone = len(jobs) == 1 and not skip_bad
    with FileProgress(len(jobs), times) as progress:
        read = in_threads(numbered(jobs), "read", stages.read, workers=threads, times=times, single=len(jobs) == 1)
        closed = one_by_one(read, str(device), stages.close, times=times)
        written = in_threads(
            closed,
            "write",
            stages.write,
            workers=threads,
            times=times,
            nbytes=lambda one: one.nbytes,
            prompt=True,
            single=len(jobs) == 1,
        )
        progress.begin(jobs[0][0].name)
        for outcome in written:
            source, target = jobs[outcome.number]
            if isinstance(outcome, Failed):
                entries.append(_failed(outcome.error, source, alone=alone))
            else:
                found[shown(source)] = _told(outcome.value, target, journal, progress)
                entries.append(_entry(source, target, outcome.value, found[shown(source)]))
            progress.end()
            if outcome.number + 1 < len(jobs):
                progress.begin(jobs[outcome.number + 1][0].name)
    if report is not None:
        write_report(entries, report, surfaces=found, seconds_of_stages=times.seconds)
        journal.close()
    return sum_up(entries, skip_bad)


def _failed(error: Exception, source: Path, *, alone: bool) -> MeshEntry:
    sentence = sentence_of(error)
    if sentence is None or alone:
        raise error
    if is_full_disk(error):
        raise FormatError(f"{sentence}; --resume goes on from there") from error
    return MeshEntry(mesh=shown(source), state="failed", reason=sentence)


def _told(made: Closed, target: Path, journal: Journal, progress: FileProgress) -> dict[str, Any]:
    """The report's part about a surface, which is kept and printed."""
    if made.report is None:
        progress.print(f"{made.read.mesh.name}: {shown(target)} is there already")
        return made.read.known or {}
    progress.print(_line(made.report, made.seconds, target))
    return journal.add(target, made.read.digest, made.report.as_dict())


def _entry(source: Path, target: Path, made: Closed, told: dict[str, Any]) -> MeshEntry:
    return MeshEntry(
        mesh=shown(source),
        state="there already" if made.report is None else "done",
        output=shown(target),
        triangles=len(made.read.mesh),
        closed=told.get("closed"),
        sign=told.get("sign"),
        seconds=None if made.report is None else round(made.seconds, 4),
    )


def _line(made: WatertightReport, seconds: float, target: Path) -> str:
    forth, back = made.input_to_output, made.output_to_input
    return (
        f"{made.name}: {made.triangles:,} triangles, {'closed' if made.closed else 'not closed'}; "
        f"{made.output_triangles:,} at an offset of {made.offset:.4g} by voxels of {made.spacing:.4g}; "
        f"mesh to surface at most {forth.largest:.4g}, on average {forth.mean:.4g}; "
        f"surface to mesh {back.largest:.4g}, {back.mean:.4g}; {seconds:.2f} s, written to {shown(target)}"
    )
