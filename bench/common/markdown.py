"""Results as Markdown tables."""

from __future__ import annotations

from typing import Any

KINDS = ("uniform", "near", "surface", "in line", "far", "voxels", "turned")
LEGEND = """\
Columns from `uniform` to `turned`: largest error of a distance against a float64 brute force over all triangles, in
roundings: 2^-24 of the largest absolute coordinate of the mesh and the point. The limit is {limit:g}. `near`: within
two voxels of a 128^3 grid; `surface`: on triangles, vertices and edges; `in line`: on the lines of edges or just beside
them; `far`: ten box sizes away; `voxels`: of a map; `turned`: of a map on turned axes with unequal spacing. Wrong
signs: against the winding number in float64, above one half being inside. Left out of that: `unclear`, the winding
number is within 1e-3 of one half; `on surface`, within 4 roundings of it. `closest point`: how far it is from the
distance, the face or the barycentric coordinates that come with it, the largest of the three, same limit."""


def markdown_table(header: list[str], rows: list[list[str]]) -> str:
    """A table whose columns line up in plain text too; all but the first are set to the right."""
    width = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]

    def line(cells: list[str]) -> str:
        padded = [c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(cells, width, strict=True))]
        return "| " + " | ".join(padded) + " |"

    rule = ["-" * w if i == 0 else "-" * (w - 1) + ":" for i, w in enumerate(width)]
    return "\n".join(line(cells) for cells in (header, rule, *rows)) + "\n"


def machine_line(report: dict[str, Any]) -> str:
    """Device, clocks, versions and commit in one sentence."""
    versions = ", ".join(f"{name} {version}" for name, version in report["versions"].items())
    clock = report.get("clocks", {})
    mhz = clock.get("sm_mhz", clock.get("cpu_mhz"))
    at = f" at {mhz:.0f} MHz" if isinstance(mhz, float) else ""
    machine = f"{report['device']}{at}, {report['cores']} cores, Python {report['python']}"
    return f"{machine}, {versions}, commit {report['commit']}."


def accuracy_markdown(report: dict[str, Any]) -> str:
    """The accuracy report as a page."""
    header = ["mesh", "triangles", "points", *KINDS, "wrong signs", "unclear", "on surface", "closest point"]
    rows, failed = [], []
    for name, result in report["meshes"].items():
        if "failed" in result:
            failed.append(f"- **{name} failed**: {result['failed']}")
            continue
        kinds = result["kinds"]
        worst = [max(kinds[k]["max_error"] or 0 for k in kinds if k.split(",")[0] == kind) for kind in KINDS]
        broken = [any(kinds[k]["max_error"] is None for k in kinds if k.split(",")[0] == kind) for kind in KINDS]
        hits = list(result["closest_point_errors"].values())
        rows.append(
            [
                name if result["fine"] else f"**{name}**",
                f"{result['triangles']:,}",
                f"{result['points']:,}",
                *("not finite" if b else f"{w:.2f}" for w, b in zip(worst, broken, strict=True)),
                f"{sum(t['wrong_signs'] for t in kinds.values())}",
                f"{sum(kinds[k]['unclear'] for k in KINDS):,}",
                f"{sum(kinds[k]['on_surface'] for k in KINDS):,}",
                "wrong" if None in hits else f"{max(hits):.2f}",
            ]
        )
    total = sum(r.get("points", 0) for r in report["meshes"].values())
    fine = sum(bool(r["fine"]) for r in report["meshes"].values())
    summary = (
        f"{fine} of {len(report['meshes'])} meshes keep every limit, at {total:,} points in all. Made by "
        f"`python -m sdm.bench.dense.accuracy` on {machine_line(report)}"
    )
    lines = [f"# Accuracy on {report['device']}", "", summary, "", LEGEND.format(limit=report["limit"]), ""]
    lines += [markdown_table(header, rows), *failed, *(f"- {note}" for note in report["left_out"])]
    return "\n".join(lines).rstrip() + "\n"
