"""Output of a comparison: one JSON file, or a folder with tables and plots too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import put, write
from sdm.errors import FormatError


def write_results(report: dict[str, Any], out: Path) -> list[Path]:
    """Write a report to `out` if it ends with .json, else to the folder `out`: results.json, report.md, *.png.

    Raises:
        FormatError: A place that cannot be written.
    """
    from sdm.bench.common.tables import results_markdown
    from sdm.bench.dense.plot_results import draw

    alone = out.suffix == ".json"
    folder_for(out)
    written = [out if alone else out / "results.json"]
    write(written[0], report)
    if not alone:
        written.append(out / "report.md")
        put(written[1], results_markdown(report))
        written += draw(report, out, "results")
    return written


def folder_for(out: Path) -> None:
    """Make the folder that a report is written to.

    Raises:
        FormatError: It cannot be made.
    """
    folder = out.parent if out.suffix == ".json" else out
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"the folder {folder} cannot be made: {error.strerror or error}") from error
