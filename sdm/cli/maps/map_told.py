"""Report of one mesh: its entry of the JSON file, and the lines that are printed."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from sdm.cli.common.failed_item import reason_of
from sdm.cli.common.printed_line import counted
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.mesh_report import MeshEntry
from sdm.cli.maps.work import MapTask, Written
from sdm.io.files.stand_in import shown
from sdm.runtime.pipeline.outcome import Done, Failed


@dataclass(frozen=True)
class Told:
    """Report of one mesh.

    Args:
        number: Of the mesh.
        entry: Its part of the report.
        lines: Of stdout.
        warnings: Of stderr.
    """

    number: int
    entry: MeshEntry
    lines: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def tell(outcome: Done[Written] | Failed, number: int, task: MapTask, settings: Settings, *, alone: bool) -> Told:
    """Report of a mesh that went through the pipeline.

    Args:
        outcome: What became of it.
        number: Of the mesh.
        task: Its files.
        settings: What is the same for all.
        alone: Its error is that of the command.

    Raises:
        FormatError: The disk is full, which every other mesh would fail by, too.
        Exception: What is no user's mistake, or the error of a mesh that is alone.
    """
    if isinstance(outcome, Failed):
        reason = reason_of(outcome, alone=alone)
        return Told(number, MeshEntry(mesh=shown(task.source), state="failed", reason=reason))
    found = outcome.value
    mesh = found.read.measured
    entry = MeshEntry(
        mesh=shown(task.source),
        state="there already" if found.read.there else "done",
        output=shown(task.target),
        triangles=len(mesh),
        closed=found.closed,
        sign=settings.sign,
        inside=found.inside,
        ambiguous_voxels=found.ambiguous if settings.sign == "winding" else None,
        warnings=[line.lstrip(": ") for line in found.warnings],
        seconds=None if found.read.there else round(found.seconds, 4),
    )
    if found.read.there:
        return Told(number, entry, [line_of_old(task)])
    return Told(
        number, entry, [_line(task, found, settings)], [f"sdm: warning: {task.name}{w}" for w in found.warnings]
    )


def line_of_old(task: MapTask) -> str:
    """Line about a mesh whose map is there."""
    return f"{task.name}: {shown(task.target)} is there already"


def tasks_of(jobs: list[tuple[Path, Path]]) -> list[MapTask]:
    """Pairs of a mesh file and the map's file, with names: paths below the folder that is common to all meshes."""
    paths = [str(source.absolute()) for source, _ in jobs]
    # As text: of a hundred thousand meshes paths take seconds.
    common = os.path.commonpath({path.rpartition(os.sep)[0] or os.sep for path in paths})
    names = [path[len(common) :].lstrip(os.sep).replace(os.sep, "/") for path in paths]
    return [MapTask(source, target, name) for (source, target), name in zip(jobs, names, strict=True)]


def _line(task: MapTask, found: Written, settings: Settings) -> str:
    grid = found.read.grid
    spacing = " x ".join(f"{s:.4g}" for s in (grid.spacing[:1] if len(set(grid.spacing)) == 1 else grid.spacing))
    size = f"{' x '.join(map(str, grid.shape))} voxels of {spacing}"
    return (
        f"{task.name}: {counted(len(found.read.mesh), 'triangle')}, {size}, "
        f"{found.seconds:.2f} s on {settings.device}, written to {shown(task.target)}"
    )
