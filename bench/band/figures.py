"""Picture of narrow bands: seconds and memory against resolution."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from sdm.bench.common.figure import STYLE, log_axes, plain_ticks, sheet

LINES = {"sdm": ("#c2341d", "-"), "OpenVDB": ("#1f5a96", "--")}
MARKS = ("o", "s", "D", "^", "v", "P")


def draw(report: dict[str, Any], path: Path) -> None:
    """Processor seconds, and bytes of the process, of each mesh and library, against voxels along an axis."""
    from matplotlib.ticker import LogLocator, NullLocator

    rows = report["rows"]
    meshes = list(dict.fromkeys(row["mesh"] for row in rows))
    with sheet(path, (13.0, 6.0), dpi=130, layout="constrained", look=STYLE) as figure:
        left, right = figure.subplots(1, 2)
        for axes, name, unit in ((left, "cpu", 1.0), (right, "peak", 2.0**20)):
            for (number, mesh), (library, (colour, dash)) in product(enumerate(meshes), LINES.items()):
                found = [row for row in rows if row["mesh"] == mesh and row["library"] == library]
                if found:
                    sizes, values = [row["resolution"] for row in found], [row[name] / unit for row in found]
                    mark = MARKS[number % len(MARKS)]
                    axes.plot(sizes, values, dash, color=colour, marker=mark, label=f"{library}, {mesh}")
            log_axes(axes)
            sizes = sorted({row["resolution"] for row in rows})
            axes.set_xticks(sizes, [str(size) for size in sizes])
            axes.xaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.set_xlabel("voxels along each axis")
            plain_ticks(axes.yaxis)
        left.set_ylabel("seconds of all cores")
        left.set_title("Time of a narrow band")
        right.set_ylabel("MiB beside the mesh")
        right.set_title("Memory")
        left.legend(fontsize=9)
        machine = report["machine"]
        figure.supxlabel(
            f"{machine['device']}, {machine['cores']} cores, half width {report['half_width']}", fontsize=8
        )
