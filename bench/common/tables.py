"""The comparison on a terminal: by rich where it is installed, else as Markdown."""

from __future__ import annotations

from typing import Any

from sdm.bench.common.markdown import machine_line, markdown_table
from sdm.bench.dense.compare_plots import of_run, ratio_table

HEADER = ["peer", "Mvoxel/s", "query ms", "spread", "build ms", "distance ms", "sign ms", "to host ms"]
HEADER += ["max error", "wrong signs", "compile ms"]
NARROWEST = 110
LEGEND = """\
Mvoxel/s: millions of voxels or points a second; ~ where a peer was timed on a random part of them, being slow.
Median of several runs; spread: slowest less fastest. Build: from arrays to the library's structure.
Distance, sign: alone, where the library lets one ask. To host: the result's way from a GPU, in no other figure.
Compile: what the first build and query took longer than later ones.
Max error: in roundings (2^-24 of the largest coordinate) against a float64 brute force. Wrong signs: of those compared.
"""


def print_results(report: dict[str, Any]) -> None:
    """All tables, then what is missing."""
    for title, rows in _tables(report):
        _print_table(title, *_filled(rows))
    print(ratio_table(of_run(report)))
    print(LEGEND)
    print("\n".join(_notes(report)))


def results_markdown(report: dict[str, Any]) -> str:
    """The same as a page."""
    tables = [f"## {title}\n\n{markdown_table(*_filled(rows))}" for title, rows in _tables(report)]
    ratios = f"## Ratios of speed\n\n{ratio_table(of_run(report))}"
    return (
        "\n".join(["# Signed distances: a comparison\n", ratios, *tables, LEGEND, *(f"- {n}" for n in _notes(report))])
        + "\n"
    )


def _tables(report: dict[str, Any]) -> list[tuple[str, list[list[str]]]]:
    found = []
    for result in report["results"]:
        title = f"{result['title']} ({result['triangles']:,} triangles)"
        if result.get("upload_ms") is not None:
            title += f", to the device in {_number(result['upload_ms'])} ms"
        found.append((title, [_row(row, result["size"]) for row in result["rows"]]))
    return found


def _filled(rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Header and rows, without columns that say nothing here."""
    kept = [i for i in range(len(HEADER)) if any(row[i] != "-" for row in rows)]
    return [HEADER[i] for i in kept], [[row[i] for i in kept] for row in rows]


def _notes(report: dict[str, Any]) -> list[str]:
    """Notes below a table: each peer's settings, the machine, and what is missing."""
    rows = [row for result in report["results"] for row in result["rows"]]
    peers = {row["peer"]: f"{row['peer']}: {row['version']}, {row['note']}" for row in rows}
    return [*peers.values(), machine_line(report), *report["missing"], *report["left_out"]]


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
        _number(row.get("download_ms")),
        "not finite" if worst is None else _number(worst),
        f"{row['wrong_signs']} of {row['points'] - row['unclear'] - row['on_surface']:,}",
        _number(max(0.0, row["first_build_ms"] + row["first_call_ms"] - row["build_ms"] - row["query_ms"])),
    ]


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return (
        f"{value:,.0f}"
        if abs(value) >= 100
        else f"{value:.3g}"
        if abs(value) >= 1e-3
        else f"{value:.1e}"
        if value
        else "0"
    )


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
