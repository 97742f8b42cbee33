"""`sdm watertight` over its meshes: where surfaces go, what is said about each, and what is left to say."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from sdm.cli.common.error_sentence import sentence_of
from sdm.cli.common.full_disk import is_full_disk
from sdm.cli.common.inputs import refuse_inputs
from sdm.cli.common.output_files import inputs_of, places_in
from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.mesh_report import MeshEntry, write_report
from sdm.cli.maps.run import sum_up
from sdm.core.device import choose_device
from sdm.engine.surface import Method
from sdm.errors import FormatError, MeshError
from sdm.io import load_mesh
from sdm.io.meshes.write import WRITERS, ending_to_write, save_mesh
from sdm.remeshing import WatertightReport, watertight
from sdm.remeshing.watertight import Hidden

DEFAULT_ENDING = "ply"


@dataclass(frozen=True)
class Closing:
    """Options that are the same for all meshes, see `sdm.watertight`."""

    resolution: int
    offset: float | None
    hole_size: float | None
    hidden: Hidden
    method: Method
    device: str


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
    jobs: list[tuple[Path, Path]], options: Closing, *, report: Path | None = None, skip_bad: bool = False
) -> int | None:
    """Close each mesh into its file; 2 if some failed and are not to be skipped. One alone raises its error."""
    choose_device(options.device)
    if report is not None:
        refuse_inputs([report], (source for source, _ in jobs))
    entries: list[MeshEntry] = []
    found: dict[str, dict[str, object]] = {}
    with FileProgress(len(jobs)) as progress:
        for source, target in jobs:
            progress.begin(source.name)
            try:
                start = time.perf_counter()
                made = _close(source, target, options)
                seconds = time.perf_counter() - start
                progress.print(_line(made, seconds, target))
                found[str(source)] = made.as_dict()
                entries.append(_entry(source, target, made, seconds))
            except Exception as error:
                sentence = sentence_of(error)
                if sentence is None or is_full_disk(error) or (len(jobs) == 1 and not skip_bad):
                    raise
                entries.append(MeshEntry(mesh=str(source), state="failed", reason=sentence))
            progress.end()
    if report is not None:
        write_report(entries, report, surfaces=found)
    return sum_up(entries, skip_bad)


def _close(source: Path, target: Path, options: Closing) -> WatertightReport:
    surface, made = watertight(
        load_mesh(source),
        options.resolution,
        options.offset,
        options.hole_size,
        hidden=options.hidden,
        method=options.method,
        device=options.device,
        return_report=True,
    )
    save_mesh(surface, target)
    return made


def _entry(source: Path, target: Path, made: WatertightReport, seconds: float) -> MeshEntry:
    return MeshEntry(
        mesh=str(source),
        state="done",
        output=str(target),
        triangles=made.triangles,
        closed=made.closed,
        sign=made.sign,
        seconds=round(seconds, 4),
    )


def _line(made: WatertightReport, seconds: float, target: Path) -> str:
    forth, back = made.input_to_output, made.output_to_input
    return (
        f"{made.name}: {made.triangles:,} triangles, {'closed' if made.closed else 'not closed'}; "
        f"{made.output_triangles:,} at an offset of {made.offset:.4g} by voxels of {made.spacing:.4g}; "
        f"mesh to surface at most {forth.largest:.4g}, on average {forth.mean:.4g}; "
        f"surface to mesh {back.largest:.4g}, {back.mean:.4g}; {seconds:.2f} s, written to {target}"
    )
