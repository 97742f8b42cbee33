"""Figures of a comparison of peers: speed of each on each mesh and grid, and the table of ratios."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdm.bench.common.figure import MARKERS, OURS, colour_of, drawing, log_axes, plain_ticks
from sdm.bench.common.markdown import machine_line, markdown_table


@dataclass(frozen=True)
class Speed:
    """Millions of voxels a second of one peer in one comparison."""

    title: str
    peer: str
    speed: float
    share: float  # of the voxels that were timed


def of_run(report: dict[str, Any]) -> list[Speed]:
    """From what `sdm bench` wrote; everyone's query alone."""
    return [
        Speed(result["title"], row["peer"], row["million_per_second"], row["asked"] / result["size"])
        for result in report["results"]
        for row in result["rows"]
    ]


def of_dense(part: dict[str, Any]) -> list[Speed]:
    """From the table of `sdm.bench.dense`; sdm's with its build."""
    found = []
    for row in part["rows"]:
        title = f"{row['mesh']} at {row['resolution']}^3"
        found.append(Speed(title, OURS, row["mvoxels_per_second"], 1.0))
        found += [Speed(title, p["peer"], p["mvoxels_per_second"], p["share"]) for p in row["peers"]]
    return found


def speeds(found: list[Speed], path: Path, caption: str) -> bool:
    """Dots: the speed of each peer, one line for each mesh and grid."""
    if not found:
        return False
    titles = list(dict.fromkeys(speed.title for speed in found))
    peers = list(dict.fromkeys(speed.peer for speed in found))
    with drawing(path, caption, (12.0, max(4.5, 2.1 + 0.42 * len(titles)))) as (figure, axes):
        height = figure.get_figheight()
        axes.set_position((0.235, 0.95 / height, 0.735, 1 - 2.05 / height))
        for y, title in enumerate(titles):
            here = [speed.speed for speed in found if speed.title == title]
            axes.plot([min(here), max(here)], [y, y], color="0.85", linewidth=2, zorder=1)
        for number, peer in enumerate(peers):
            mine = [speed for speed in found if speed.peer == peer]
            axes.scatter(
                [speed.speed for speed in mine],
                [titles.index(speed.title) for speed in mine],
                s=110 if peer == OURS else 70,
                marker=MARKERS[number % len(MARKERS)],
                color=colour_of(peer, peers),
                label=peer,
                zorder=3 if peer == OURS else 2,
            )
        log_axes(axes, y=False)
        axes.set_yticks(range(len(titles)))
        axes.set_yticklabels([title.replace("^3", "³").replace("torus-1000000", "torus of 1M") for title in titles])
        axes.set_ylim(len(titles) - 0.5, -0.5)
        axes.tick_params(axis="y", length=0)
        plain_ticks(axes.xaxis)
        axes.set_xlabel("million voxels or points a second")
        axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=4, columnspacing=1.2, handletextpad=0.3)
        figure.text(0.012, 1 - 0.38 / height, "Signed distances: speed of each library", fontsize=16, weight="bold")
    return True


def growth(report: dict[str, Any], path: Path) -> bool:
    """Lines, one panel for each mesh: time of a map against its number of voxels, for meshes on several grids."""
    times: dict[str, dict[str, list[tuple[int, float]]]] = {}
    for result in report["results"]:
        if result["title"].endswith("^3"):
            for row in result["rows"]:
                at = (result["size"], result["size"] / row["million_per_second"] / 1e3)
                times.setdefault(result["mesh"], {}).setdefault(row["peer"], []).append(at)
    times = {mesh: peers for mesh, peers in times.items() if any(len(found) > 1 for found in peers.values())}
    if not times:
        return False
    from matplotlib.ticker import FixedLocator, NullLocator

    peers = list(dict.fromkeys(peer for found in times.values() for peer in found))
    with drawing(path, "Query alone. " + machine_line(report), (4.4 + 3.8 * (len(times) - 1) + 3.0, 5.6)) as (
        fig,
        whole,
    ):
        whole.remove()
        width = fig.get_figwidth()
        panels = fig.subplots(1, len(times), sharey=True, squeeze=False)[0]
        fig.subplots_adjust(left=1.15 / width, right=1 - 2.75 / width, bottom=0.17, top=0.83, wspace=0.08)
        for axes, (mesh, found) in zip(panels, times.items(), strict=True):
            log_axes(axes)
            for number, peer in enumerate(peers):
                if peer in found:
                    shown = colour_of(peer, peers)
                    axes.plot(
                        *zip(*sorted(found[peer]), strict=True), color=shown, marker=MARKERS[number % 8], label=peer
                    )
            axes.set_title(mesh, fontsize=12, pad=8)
            sizes = sorted({size for points in found.values() for size, _ in points})
            axes.xaxis.set_major_locator(FixedLocator(sizes))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.set_xticklabels([f"{round(size ** (1 / 3))}³" for size in sizes])
            axes.set_xlabel("voxels")
            plain_ticks(axes.yaxis)
        panels[0].set_ylabel("milliseconds")
        handles, labels = panels[-1].get_legend_handles_labels()
        fig.legend(handles, labels, loc="center left", bbox_to_anchor=(1 - 2.65 / width, 0.5))
        fig.text(0.012, 0.94, "Time of a map against its size", fontsize=16, weight="bold")
    return True


def ratio_table(found: Iterable[Speed]) -> str:
    """Markdown: times as fast as each peer that sdm is; ~ where a peer was timed on a part."""
    found = list(found)
    titles = list(dict.fromkeys(speed.title for speed in found))
    peers = [peer for peer in dict.fromkeys(speed.peer for speed in found) if peer != OURS]
    by = {(speed.title, speed.peer): speed for speed in found}
    rows = []
    for title in titles:
        mine = by.get((title, OURS))
        cells = []
        for peer in peers:
            other = by.get((title, peer))
            if mine is None or other is None:
                cells.append("-")
            else:
                cells.append(("~" if other.share < 1 else "") + f"{mine.speed / other.speed:.3g}")
        rows.append([title, *cells])
    return markdown_table(["sdm is faster by", *peers], rows)
