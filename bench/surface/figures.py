"""Pictures of surfaces: seconds against resolution, and of `sdm watertight` from file to file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.bench.common.figure import STYLE, log_axes, plain_ticks, sheet

MARKS = ("o", "s", "D", "^", "v", "P")


def draw(report: dict[str, Any], path: Path) -> None:
    """Seconds of each method against voxels along an axis, a panel for each mesh: on a CPU those of all cores."""
    rows, machine = report["rows"], report["machine"]
    part, label = ("seconds", "seconds") if "sm_mhz" in machine.get("clocks", {}) else ("cpu", "seconds of all cores")
    meshes = list(dict.fromkeys(row["mesh"] for row in rows))
    sizes = sorted({row["resolution"] for row in rows})
    with sheet(path, (4.6 * len(meshes) + 1, 5.0), dpi=110, layout="constrained", look=STYLE) as figure:
        panels = figure.subplots(1, len(meshes), squeeze=False, sharey=True)[0]
        for axes, mesh in zip(panels, meshes, strict=True):
            for number, method in enumerate(dict.fromkeys(row["method"] for row in rows)):
                found = [row for row in rows if (row["mesh"], row["method"]) == (mesh, method)]
                dash = "-" if method.startswith("sdm") else "--"
                axes.plot(
                    [row["resolution"] for row in found],
                    [row[part] for row in found],
                    dash,
                    marker=MARKS[number % len(MARKS)],
                    label=method,
                )
            log_axes(axes)
            axes.set_xticks(sizes, [str(size) for size in sizes])
            if len(sizes) == 1:
                axes.set_xlim(sizes[0] / 2, 2 * sizes[0])
            axes.minorticks_off()
            axes.set_xlabel("voxels along each axis")
            axes.set_title(mesh)
            plain_ticks(axes.yaxis)
        panels[0].set_ylabel(label)
        panels[0].legend(fontsize=8)
        figure.supxlabel(f"{machine['device']}, {machine['cores']} cores, repeated calls", fontsize=8)


def draw_watertight(report: dict[str, Any], path: Path) -> None:
    """Bars of each mesh and resolution: the first call of a process, repeated ones, and a file of a folder."""
    rows, parts = report["rows"], {"first": "first call", "warm": "repeated call", "folder": "a file of a folder"}
    with sheet(path, (7.0, 1.6 + 0.9 * len(rows)), dpi=110, layout="constrained", look=STYLE) as figure:
        axes = figure.subplots()
        for number, (part, label) in enumerate(parts.items()):
            places = [place + 0.25 * (1 - number) for place in range(len(rows))]
            bars = axes.barh(places, [row[part] for row in rows], 0.22, label=label)
            axes.bar_label(bars, fmt="%.2f", padding=3, fontsize=8)
        axes.set_yticks(range(len(rows)), [f"{row['mesh']}, {row['resolution']}^3" for row in rows])
        axes.set_xlabel("seconds from file to file")
        axes.legend(fontsize=8)
        machine = report["machine"]
        figure.supxlabel(f"{machine['device']}, {machine['cores']} cores", fontsize=8)
