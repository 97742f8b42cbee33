"""Remarks about a map and its mesh, as lines that go on after the mesh's name."""

from __future__ import annotations

from sdm.cli.common.printed_line import counted
from sdm.cli.maps.work import ReadMesh
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.arguments import Sign
from sdm.engine.checks.map_check import doubts_about


def remarks(read: ReadMesh, closed: bool, inside: int, ambiguous: int, sign: Sign) -> list[str]:
    """All there is to know about a map, the gravest first."""
    found = [] if read.measured is read.mesh else [_turned(read.mesh, read.measured)]
    doubts = doubts_about(read.measured, read.grid, inside, sign)
    found += [f": {doubt}" for doubt in doubts]
    if sign == "winding" and not closed:
        found += _about_gaps(inside, ambiguous, bool(doubts), read.grid)
    return found


def _turned(mesh: TriangleMesh, measured: TriangleMesh) -> str:
    """Said of a mesh some of whose faces were turned."""
    count = int((mesh.faces != measured.faces.to(mesh.device)).any(1).sum())
    if count == len(mesh):
        return " was inside out and has been turned"
    return f": {count:,} of its {len(mesh):,} faces looked inward, or disagreed with others, and have been turned"


def _about_gaps(inside: int, ambiguous: int, doubtful: bool, grid: Grid) -> list[str]:
    """Said of a mesh that is not closed, where there is anything to add to the doubts about it."""
    if ambiguous:
        share = 100 * ambiguous / grid.size
        voxels, are = counted(ambiguous, "voxel"), "is" if ambiguous == 1 else "are"
        text = (
            f" is not closed: whether {voxels} ({share:.2g} %) {are} inside is ambiguous; "
            "the sign follows the generalised winding number (sdm inspect tells more)"
        )
        return [text]
    if doubtful:
        return []
    return [" is not closed, but no voxel is ambiguous" if inside else " is not closed, and no voxel is inside"]
