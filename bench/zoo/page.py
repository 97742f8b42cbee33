"""The table of `sdm.bench.zoo` as a page."""

from __future__ import annotations

from typing import Any

from sdm.bench.common.markdown import machine_line, markdown_table

LEGEND = """\
Worst: the largest error of random points and voxels against a float64 brute force, in roundings of 2^-24 of the largest
coordinate; the limit is 4, and no sign may be wrong where the winding number is further than 1e-3 from one half.
Milliseconds of a map of {resolution}^3 voxels from vertices and faces, the first and the fastest of the next three; of
stock Warp the query alone, by the faster of its trees. Other work ran on the machine at the same time."""


def page(report: dict[str, Any]) -> str:
    """A line for each mesh, then the sentences that refused files."""
    summary, header = report["summary"], ["mesh", "triangles", "parts", "boundary edges", "sign", "ambiguous", "worst"]
    header += ["first ms", "repeated ms", "stock ms"]
    lines = [_line(row) for row in report["rows"] if "checked" in row]
    refused = [f"- {row['refused']}" for row in report["rows"] if "refused" in row]
    broken = [f"- **{row['mesh']}**: {row['broken']}" for row in report["rows"] if "broken" in row]
    counts = (
        f"{summary['files']} files: {summary['measured']} measured, {summary['wrong']} of them wrong, "
        f"{summary['refused']} refused, {summary['broken']} broke something; {summary['points_and_voxels']:,} points "
        f"and voxels, the worst {summary['worst_roundings']:.2f} roundings off. Made by `python -m sdm.bench.zoo` on "
        f"{machine_line(report['machine'])}"
    )
    legend = LEGEND.format(resolution=report["resolution"])
    parts = ["# Foreign meshes", counts, legend, markdown_table(header, lines), *([] if not broken else ["## Broken"])]
    return "\n\n".join([*parts, *broken, "## Refused", "\n".join(refused)]).rstrip() + "\n"


def _line(row: dict[str, Any]) -> list[str]:
    checked = row["checked"]
    name = row["mesh"].replace("|", "\\|")
    wrong = checked["over_limit"] or checked["wrong_signs"]
    return [
        f"**{name}**" if wrong else name,
        f"{row['triangles']:,}",
        str(row["components"]),
        "closed" if row["closed"] else str(row["boundary_edges"]),
        row["sign"],
        f"{row['ambiguous_voxels']:,}",
        f"{checked['max_error'] or 0:.2f}",
        f"{row['first_ms']:.3g}",
        f"{row['repeated_ms']:.3g}",
        f"{row['stock_ms']:.3g}",
    ]
