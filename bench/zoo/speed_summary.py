"""Means, quantiles and the picture of `sdm.bench.zoo.speed`."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.figure import COLOURS, OURS, drawing, log_axes, plain_ticks

QUANTILES = (5, 25, 50, 75, 95)


def summaries(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """For each resolution: meshes, geometric means, quantiles of stock's time over ours, and who is slower."""
    found = {}
    for resolution in sorted({row["resolution"] for row in rows}):
        some = [row for row in rows if row["resolution"] == resolution]
        ratios = [row["stock_over_first"] for row in some]
        slower = sorted((row for row in some if row["stock_over_first"] < 1), key=lambda row: row["stock_over_first"])
        found[str(resolution)] = {
            "meshes": len(some),
            "stock_over_first": statistics.geometric_mean(ratios),
            "stock_over_repeated": statistics.geometric_mean([row["stock_over_repeated"] for row in some]),
            "quantiles": {str(q): float(np.percentile(ratios, q)) for q in QUANTILES},
            "slower_than_stock": len(slower),
            "slowest": [row["mesh"] for row in slower[:10]],
            "first_ms": statistics.geometric_mean([row["first_ms"] for row in some]),
            "first_over_repeated": statistics.geometric_mean([row["first_ms"] / row["repeated_ms"] for row in some]),
            "wrong": sum(row["wrong"] for row in some),
        }
    return found


def lines(summary: dict[str, dict[str, Any]]) -> list[list[str]]:
    """The same as a table, a line for each resolution."""
    quantiles = ", ".join(f"{q} %" for q in QUANTILES)
    header = [
        "grid",
        "meshes",
        "stock / first call",
        quantiles,
        "slower",
        "first call [ms]",
        "stock / repeated",
        "wrong",
    ]
    return [
        header,
        *(
            [
                f"{resolution}^3",
                str(found["meshes"]),
                f"{found['stock_over_first']:.2f}",
                ", ".join(f"{ratio:.2g}" for ratio in found["quantiles"].values()),
                str(found["slower_than_stock"]),
                f"{found['first_ms']:.2f}",
                f"{found['stock_over_repeated']:.2f}",
                str(found["wrong"]),
            ]
            for resolution, found in summary.items()
        ),
    ]


def draw(report: dict[str, Any], path: Path) -> None:
    """Stock's time over ours for all meshes in ascending order, a line for each resolution."""
    machine = report["machine"]
    caption = (
        f"{machine['device']}. First call of each mesh, topology and tree counted; stock "
        "Warp's query alone, by the faster of its trees."
    )
    with drawing(path, caption) as (_, axes):
        axes.set_title("How many times faster than stock Warp, meshes seen for the first time")
        shades = [COLOURS["Warp winding number"], COLOURS[OURS], *COLOURS.values()]
        for colour, (resolution, found) in zip(shades, report["summary"].items(), strict=False):
            some = [row["stock_over_first"] for row in report["rows"] if str(row["resolution"]) == resolution]
            share = 100 * (np.arange(len(some)) + 0.5) / len(some)
            label = (
                f"{resolution}³: geometric mean {found['stock_over_first']:.2g}, {found['slower_than_stock']} slower"
            )
            axes.plot(share, sorted(some), "o-", color=colour, markersize=4, label=label)
        axes.axhline(1.0, color="0.4", linewidth=1.2, linestyle=(0, (1, 2)))
        axes.set_xlabel("share of the meshes [%]")
        axes.set_ylabel("stock's time / ours")
        log_axes(axes, x=False)
        plain_ticks(axes.yaxis)
        axes.legend(loc="upper left")
