"""`sdm inspect`: properties of a mesh, and its problems."""

from __future__ import annotations

import json as as_json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from sdm.cli.common.printed_line import printable

if TYPE_CHECKING:
    from sdm.inspect import MeshReport


def inspect(mesh: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MESH")], *, json: bool = False) -> None:
    """Say what a mesh is like: closed, oriented, outward, manifold, and what is wrong with it.

    Lengths, areas and volumes are in the mesh's own unit. Problems are reported, not repaired, and the exit code is 0.

    Args:
        mesh: Mesh file (STL, PLY, OBJ, OFF, GLB, ...).
        json: Print JSON instead of a table.
    """
    from sdm.inspect import inspect_mesh
    from sdm.io import load_mesh

    report = inspect_mesh(load_mesh(mesh))
    if json:
        print(as_json.dumps(report.as_dict(), indent=2))
        return
    _print_table(report)


def _print_table(report: MeshReport) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    # As Text, since a name may look like markup.
    name = Text(printable(report.name))
    table = Table(title=name, title_justify="left", show_header=False, box=None, padding=(0, 2, 0, 0))
    for fact, value in _rows(report):
        table.add_row(fact, Text(value, overflow="fold"))
    console.print(table)
    if not report.problems:
        console.print("no problems found", style="green")
    for problem in report.problems:
        # The whole sentence on one line, for whoever reads it through a pipe.
        console.print(f"- {problem}", style="yellow", markup=False, soft_wrap=True)


def _rows(report: MeshReport) -> list[tuple[str, str]]:
    low, high = (" ".join(f"{x:.6g}" for x in corner) for corner in report.bounds)
    return [
        ("triangles", f"{report.triangles:,}"),
        ("vertices", f"{report.vertices:,}"),
        ("bounds", f"{low}  to  {high}"),
        ("closed", _yes(report.closed)),
        ("oriented", _yes(report.oriented)),
        ("faces outward", "undefined" if report.outward is None else _yes(report.outward)),
        ("manifold", _yes(report.manifold)),
        ("components", f"{report.components:,}"),
        ("degenerate faces", f"{report.degenerate_faces:,}"),
        ("duplicate faces", f"{report.duplicate_faces:,}"),
        ("boundary edges", f"{report.boundary_edges:,}"),
        ("nonmanifold edges", f"{report.nonmanifold_edges:,}"),
        ("volume", "undefined" if report.volume is None else f"{report.volume:.6g}"),
        ("area", f"{report.area:.6g}"),
        ("recommended sign", f"{report.recommended_sign}: {report.recommendation}"),
    ]


def _yes(fact: bool) -> str:
    return "yes" if fact else "no"
