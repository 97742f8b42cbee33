"""Report about the meshes of a folder: a JSON file, and a table of those that were left out."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sdm.cli.common.printed_line import counted, printable
from sdm.io.files.json_file import write_json

VERSION = 1
# Of the column of names in the table: a single long one does not push all reasons off the screen.
WIDEST = 60


@dataclass(frozen=True, kw_only=True)
class MeshEntry:
    """A mesh of the report.

    Args:
        mesh: Its file.
        output: The file or files that were written; None if none were.
        state: "done", "there already" or "failed".
        reason: Of a mesh that failed, the sentence about it.
        triangles: How many it has, where it could be read.
        closed: Whether it has no boundary.
        sign: The method by which its distances are signed.
        inside: How many voxels, or samples, are inside.
        ambiguous_voxels: For how many voxels the mesh does not say so clearly.
        warnings: What else there is to know.
        seconds: That it took in all stages, which run beside those of other meshes.
    """

    mesh: str
    state: str
    output: str | None = None
    reason: str | None = None
    triangles: int | None = None
    closed: bool | None = None
    sign: str | None = None
    inside: int | None = None
    ambiguous_voxels: int | None = None
    warnings: list[str] = field(default_factory=list)
    seconds: float | None = None


def write_report(entries: list[MeshEntry], path: Path, **more: Any) -> None:
    """Write the report of all meshes, in their order, beside what else there is to tell of the run."""
    content = {
        "version": VERSION,
        **more,
        "meshes": [{key: value for key, value in asdict(entry).items() if value is not None} for entry in entries],
    }
    write_json(path, content)


def failures_table(entries: list[MeshEntry]) -> list[str]:
    """Lines of a table of the meshes that failed, and the counts of all."""
    failed = [entry for entry in entries if entry.state == "failed"]
    counts = {state: sum(entry.state == state for entry in entries) for state in ("done", "there already", "failed")}
    warned = sum(bool(entry.warnings) for entry in entries)
    width = min(WIDEST, max((len(printable(entry.mesh)) for entry in failed), default=0))
    lines = [f"{printable(entry.mesh):<{width}}  {entry.reason}" for entry in failed]
    said = ", ".join(f"{count:,} {state}" for state, count in counts.items() if count or state == "done")
    said += f", {warned:,} with warnings" if warned else ""
    return [*lines, f"{counted(len(entries), 'mesh', 'meshes')}: {said}"]
