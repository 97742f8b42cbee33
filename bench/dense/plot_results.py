"""Plots: `python -m sdm.bench.dense.plot_results RESULTS.json ... --out DIR` writes PNG files, one idea each.

Takes files of `sdm.bench.dense` and of `sdm bench`; what a file does not hold is not drawn.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdm import FormatError, SDMError
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.markdown import machine_line
from sdm.bench.dense import compare_plots as peers
from sdm.bench.dense import plots as dense


def draw(report: dict[str, Any], folder: Path, name: str) -> list[Path]:
    """Draw one results file into `folder`, as NAME-*.png; returns what was written."""
    written = []

    def keep(drawn: bool, path: Path) -> None:
        if drawn:
            written.append(path)

    def to(what: str) -> Path:
        return folder / f"{name}-{what}.png"

    if "results" in report:
        keep(peers.speeds(peers.of_run(report), to("speed"), machine_line(report)), to("speed"))
        keep(peers.growth(report, to("growth")), to("growth"))
    parts = report.get("parts", {})
    if "table" in parts:
        table = parts["table"]
        keep(dense.ratios(table, to("ratios")), to("ratios"))
        caption = "sdm with its build, peers without. " + dense.machine(table)
        keep(peers.speeds(peers.of_dense(table), to("speed"), caption), to("speed"))
    for part, function in (
        ("triangles", dense.triangles),
        ("resolution", dense.resolutions),
        ("worst", dense.worst),
    ):
        # A part that was cut off has rows, but no summary yet.
        if "summary" in parts.get(part, {}):
            keep(function(parts[part], to(part)), to(part))
    return written


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 2 for a file that is not one of these."""
    parser = argparse.ArgumentParser(
        "python -m sdm.bench.dense.plot_results", description=(__doc__ or "").split("\n", maxsplit=1)[0]
    )
    parser.add_argument("results", nargs="+", type=Path, help="JSON files of sdm.bench.dense or sdm bench")
    parser.add_argument("--out", type=Path, default=results_folder() / "plots", help="folder for the pictures")
    options = parser.parse_args(argv)
    try:
        for path in options.results:
            for written in draw(_read(path), options.out, path.stem):
                print(written)
    except SDMError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _read(path: Path) -> dict[str, Any]:
    try:
        report = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read as JSON: {error}") from error
    if not isinstance(report, dict) or not {"parts", "results"} & set(report):
        raise FormatError(f"{path} holds no results of sdm.bench.dense or sdm bench")
    return report


if __name__ == "__main__":
    sys.exit(main())
