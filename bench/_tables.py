"""The comparison on a terminal: by rich where it is installed, else as Markdown."""

from __future__ import annotations

from typing import Any

from bench._report import machine_line, markdown_table

HEADER = ["peer", "Mvoxel/s", "query ms", "spread", "build ms", "distance ms", "sign ms"]
HEADER += ["max error", "wrong signs", "first ms"]
NARROWEST = 100
LEGEND = """\
Mvoxel/s: millions of voxels or points a second; ~ where a peer was timed on a random part of them, being slow.
Median of several runs; spread: slowest less fastest. Build: from arrays to the library's structure.
Distance, sign: alone, where the library lets one ask. First: build and query with compiling, which no other
figure has.
Max error: in roundings (2^-24 of the largest coordinate) against a float64 brute force. Wrong signs: of those compared.
"""


def print_results(report: dict[str, Any]) -> None:
    """All tables, then what is missing."""
    notes: dict[str, str] = {}
    for result in report["results"]:
        title = f"{result['title']} ({result['triangles']:,} triangles)"
        _print_table(title, HEADER, [_row(row, result["size"]) for row in result["rows"]])
        notes |= {row["peer"]: f"{row['version']}, {row['note']}" for row in result["rows"]}
    print(LEGEND)
    print("\n".join(f"{peer}: {note}" for peer, note in notes.items()))
    print(machine_line(report))
    for note in (*report["missing"], *report["left_out"]):
        print(note)


def _row(row: dict[str, Any], size: int) -> list[str]:
    worst = row["max_error"]
    return [
        row["peer"],
        ("~" if row["asked"] < size else "") + _number(row["million_per_second"]),
        _number(row["query_ms"]),
        f"{row['spread_percent']:.0f} %",
        _number(row["build_ms"]),
        _number(row.get("distance_ms")),
        _number(row.get("sign_ms")),
        "not finite" if worst is None else _number(worst),
        f"{row['wrong_signs']} of {row['points'] - row['unclear'] - row['on_surface']:,}",
        _number(row["first_build_ms"] + row["first_call_ms"]),
    ]


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}" if abs(value) >= 1e-3 else "0"


def _print_table(title: str, header: list[str], rows: list[list[str]]) -> None:
    try:
        from rich.box import SIMPLE_HEAD
        from rich.console import Console
        from rich.table import Table
    except ImportError:
        print(f"\n{title}\n\n{markdown_table(header, rows)}")
        return
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for number, name in enumerate(header):
        table.add_column(name.replace(" ", "\n"), justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # Narrower than its figures a table cannot be read.
    Console(width=max(NARROWEST, Console().width)).print(table)
