"""Figures of what `sdm.bench.dense` measured: ratios, growth with triangles and resolution, batches, hard meshes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdm.bench.common.figure import MARKERS, OURS, colour_of, drawing, guide, log_axes, plain_ticks, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Rows = list[dict[str, Any]]
GRID_SHADES = ("#f2b6a8", "#e0725a", "#a92a16")


def machine(part: dict[str, Any]) -> str:
    """One line on what it was measured on."""
    about = part["machine"]
    warp = about["versions"].get("warp-lang")
    return f"{about['device']}, {about['cores']} CPU cores, Warp {warp}"


def ratios(part: dict[str, Any], path: Path) -> bool:
    """Bars: times as fast as the fastest peer, for each mesh and resolution, and the geometric means."""
    rows = [row for row in part["rows"] if row["ratio"]]
    if not rows:
        return False
    meshes = list(dict.fromkeys(row["mesh"] for row in rows))
    resolutions = sorted({row["resolution"] for row in rows})
    means = part["summary"]["geometric_means"]
    caption = (
        "sdm: repeated calls (a CUDA graph on a GPU), topology + build + query of a mesh as large as one before; "
        "peers: query alone, the fastest of them. " + machine(part)
    )
    with drawing(path, caption) as (_, axes):
        axes.set_title("Exact signed distance maps, repeated: times as fast as the fastest peer")
        wide = 0.8 / len(resolutions)
        names = [*meshes, "geometric mean"]
        for number, resolution in enumerate(resolutions):
            here = {row["mesh"]: row["ratio"] for row in rows if row["resolution"] == resolution}
            here["geometric mean"] = means[str(resolution)]["fastest peer"]
            offset = (number - (len(resolutions) - 1) / 2) * wide
            places = [at + offset + (0.25 if name == "geometric mean" else 0) for at, name in enumerate(names)]
            shown = [here.get(name, 0.0) for name in names]
            shade = GRID_SHADES[number % 3]
            axes.bar(places, shown, width=0.92 * wide, color=shade, label=f"{resolution}³")
            for x, value in zip(places, shown, strict=True):
                if value:
                    axes.text(x, value * 1.04, f"{value:.3g}", ha="center", va="bottom", fontsize=11, color="0.25")
        log_axes(axes, x=False)
        plain_ticks(axes.yaxis)
        low = min(row["ratio"] for row in rows)
        axes.set_ylim(bottom=min(1.0, 0.7 * low), top=2.2 * max(row["ratio"] for row in rows))
        axes.axhline(1.0, color="0.4", linewidth=1)
        axes.set_ylabel("times as fast")
        axes.set_xticks([*range(len(meshes)), len(meshes) + 0.25])
        count = {row["mesh"]: short(row["triangles"]) for row in rows}
        labels = [f"{name.replace('torus-1000000', 'torus')}\n{count[name]} triangles" for name in meshes]
        axes.set_xticklabels([*labels, "geometric\nmean"])
        axes.tick_params(axis="x", length=0)
        axes.legend(loc="upper left", ncols=4, bbox_to_anchor=(0.0, 1.02))
    return True


def _caption(title: str, part: dict[str, Any]) -> str:
    return f"{title}. sdm: repeated calls (a CUDA graph on a GPU); peers: query alone. {machine(part)}"


def _curves(axes: Axes, rows: Rows, x: str, build: bool) -> None:
    """Lines of sdm and of each peer; a peer's only where it was timed."""
    at = [row[x] for row in rows]
    peers = list(dict.fromkeys(peer["peer"] for row in rows for peer in row["peers"]))
    for number, name in enumerate(peers):
        found = [(row[x], p["ms"]) for row in rows for p in row["peers"] if p["peer"] == name]
        axes.plot(*zip(*found, strict=True), color=colour_of(name, peers), marker=MARKERS[number + 1], label=name)
    axes.plot(
        at, [row["new_mesh"]["ms"] for row in rows], color=colour_of(OURS, []), marker="o", label="sdm, build included"
    )
    if build:
        some = [row for row in rows if "build_new" in row]
        axes.plot(
            [row[x] for row in some],
            [row["build_new"]["ms"] for row in some],
            color=colour_of(OURS, []),
            linewidth=1.4,
            linestyle="--",
            label="topology and build, called alone",
        )


def triangles(part: dict[str, Any], path: Path) -> bool:
    """Time against the number of triangles, with the straight line of a cost that is linear."""
    rows = part["rows"]
    if len(rows) < 2:
        return False
    with drawing(path, _caption("Torus", part)) as (_, axes):
        log_axes(axes)
        _curves(axes, rows, "triangles", build=True)
        first, last = rows[0], rows[-1]
        guide(axes, (first["triangles"], first["new_mesh"]["ms"]), last["triangles"], 1.0, "linear")
        plain_ticks(axes.yaxis)
        from matplotlib.ticker import FuncFormatter

        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
        axes.set_xlabel("triangles")
        axes.set_ylabel("milliseconds")
        slopes = [part["summary"][f"new_mesh_exponent{end}"] for end in ("", "_at_the_end")]
        powers = "{:.2f}, at the end {:.2f}".format(*slopes)
        axes.set_title(f"Time of a {rows[0]['resolution']}³ map grows as triangles to the power {powers}")
        axes.legend(loc="upper left")
        axes.margins(x=0.07)
    return True


def resolutions(part: dict[str, Any], path: Path) -> bool:
    """Time against resolution, with the slopes of a volume and of a surface."""
    rows = part["rows"]
    if len(rows) < 2:
        return False
    from matplotlib.ticker import FixedLocator, NullLocator

    title = f"{rows[0]['mesh']}, {rows[0]['triangles']:,} triangles"
    with drawing(path, _caption(title, part)) as (_, axes):
        log_axes(axes)
        _curves(axes, rows, "resolution", build=True)
        last, top = rows[-1], rows[-1]["new_mesh"]["ms"]
        step = last["resolution"] / rows[-2]["resolution"]
        for slope, text in ((3.0, "voxels: N³"), (2.0, "surface: N²")):
            # Both begin below the curve's last third, and part from there.
            guide(axes, (last["resolution"] / step**2, 0.3 * top / step**6), last["resolution"], slope, text)
        axes.xaxis.set_major_locator(FixedLocator([row["resolution"] for row in rows]))
        axes.xaxis.set_minor_locator(NullLocator())
        plain_ticks(axes.xaxis, "{:.0f}³")
        plain_ticks(axes.yaxis)
        axes.set_xlabel("voxels")
        axes.set_ylabel("milliseconds")
        axes.set_title("Time of a map against its resolution")
        axes.legend(loc="upper left")
        axes.margins(x=0.1)
        if "slab_bytes" in last:
            axes.annotate(
                "in slabs",
                (last["resolution"], last["new_mesh"]["ms"]),
                xytext=(10, -16),
                textcoords="offset points",
                color="0.35",
                fontsize=11,
            )
    return True


def worst(part: dict[str, Any], path: Path) -> bool:
    """Bars: time of each hard mesh over that of an ordinary one with as many triangles."""
    rows = part["rows"]
    if not rows:
        return False
    text = f"{short(rows[0]['ordinary']['triangles'])} triangles, {rows[0]['resolution']}³"
    with drawing(path, f"Ordinary: a torus, {text}; build included. " + machine(part)) as (_, axes):
        axes.set_position((0.19, 0.145, 0.77, 0.745))
        axes.set_title("Meshes made to be hard: time against an ordinary mesh's")
        names = [f"{row['mesh']}\n{short(row['triangles'])} triangles" for row in rows]
        values = [row["ratio_to_ordinary"] for row in rows]
        axes.barh(names, values, color=GRID_SHADES[1], height=0.6)
        for y, row in enumerate(rows):
            label = f"{values[y]:.2f}x   {row['new_mesh']['ms']:.3g} ms"
            axes.text(values[y] * 1.06, y, label, va="center", fontsize=12, color="0.25")
        axes.set_xscale("log")
        limit = part["summary"]["limit"]
        axes.axvline(limit, color="black", linewidth=1.6)
        axes.text(limit * 1.04, -0.42, f"limit {limit}x", fontsize=11, color="0.2")
        axes.axvline(1.0, color="0.75", linewidth=1, zorder=0)
        axes.set_xlim(min(0.5, 0.7 * min(values)), 3 * max(limit, *values))
        plain_ticks(axes.xaxis)
        axes.set_xlabel("times the ordinary mesh's")
        axes.tick_params(axis="y", length=0)
        axes.invert_yaxis()
    return True
