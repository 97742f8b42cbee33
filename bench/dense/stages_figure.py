"""Draw the stages of the fast dense path on a slice of the built-in mesh: `python -m sdm.bench.dense.stages_figure`.

Every list and every value in the picture is computed by bench/dense/stages.py, the test of
kernels/culling/witness_bound.py in the plane. Regions, cones of normals and parts of triangles are left out: octants
are told apart by the same test, where the kernels ask which parts of the cell's triangles matter to each.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sdm.bench.common.checkout import docs_folder
from sdm.bench.common.figure import STYLE
from sdm.bench.dense import stages
from sdm.io.files.atomic import replacing
from sdm.viz.style import colour_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PIXELS = 96
# The normal of the cut: nearly along the spiral's axis, so that the tube is met lengthwise and across.
PLANE = (0.45, 0.15, 1.0)
KEPT, PASSED, PICKED = "#c2341d", "#e8a33d", "#1f5a96"


def outline() -> np.ndarray:
    """Segments (S,2,2) where a plane cuts the built-in mesh, scaled to 1.7 in the square from -1 to 1."""
    import trimesh

    from sdm.core.demo_mesh import demo_mesh

    vertices, faces = demo_mesh(rings=121, segments=40, cap_rings=5).numpy()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    cut: Any = trimesh.intersections.mesh_plane(mesh, np.array(PLANE), vertices.mean(0))
    flat = np.asarray(cut)[:, :, :2]
    low, high = flat.reshape(-1, 2).min(0), flat.reshape(-1, 2).max(0)
    return (flat - (low + high) / 2) / (high - low).max() * 1.7


def main(argv: Sequence[str] | None = None) -> int:
    """Draw into the file given, else docs/stages.png."""
    parser = argparse.ArgumentParser(
        "python -m sdm.bench.dense.stages_figure", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--out", type=Path, default=docs_folder() / "stages.png", help="PNG file to write")
    draw(parser.parse_args(argv).out)
    return 0


def draw(path: Path) -> None:
    """Draw the four panels."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    segments = outline()
    step = 2.0 / PIXELS
    low = -1 + step / 2
    everything = np.arange(len(segments))
    cells = stages.boxes(low, step, PIXELS, stages.CELL)
    lists = [stages.kept(cell, segments, everything) for cell in cells]
    octants = stages.boxes(low, step, PIXELS, stages.OCTANT)
    across = PIXELS // stages.OCTANT
    per_cell = stages.CELL // stages.OCTANT
    owner = [(n // across // per_cell) * (PIXELS // stages.CELL) + n % across // per_cell for n in range(len(octants))]
    short = [stages.kept(octant, segments, lists[cell]) for octant, cell in zip(octants, owner, strict=True)]
    # The cell where direction tells apart most of what distance alone would keep; the octant in it likewise.
    gains = [_passed(cell, segments, everything) - len(found) for cell, found in zip(cells, lists, strict=True)]
    picked_cell = int(np.argmax(gains))
    inner = [n for n in range(len(octants)) if owner[n] == picked_cell]
    picked_octant = max(inner, key=lambda n: _passed(octants[n], segments, lists[picked_cell]) - len(short[n]))

    with mpl.rc_context({**STYLE, "font.size": 10.5, "axes.titlesize": 12.5, "axes.titlepad": 9.0}):
        figure = Figure(figsize=(13.0, 13.6), facecolor="white")
        FigureCanvasAgg(figure)
        panels = figure.subplots(2, 2)
        figure.subplots_adjust(left=0.03, right=0.97, top=0.925, bottom=0.035, wspace=0.06, hspace=0.16)
        figure.text(0.03, 0.965, "From all triangles to exact distances, on a slice", fontsize=18, weight="bold")
        _lists(panels[0, 0], segments, cells, lists, picked_cell, everything)
        _title(panels[0, 0], "1  Cells of 8³", lists, len(segments))
        _lists(panels[0, 1], segments, octants, short, picked_octant, lists[owner[picked_octant]])
        _title(panels[0, 1], "2  Octants of 4³", short, len(segments))
        _proof(panels[1, 0], segments, cells[picked_cell])
        _values(panels[1, 1], segments, octants, short, step)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            figure.savefig(part, format="png", dpi=110)


def _passed(box: stages.Box, segments: np.ndarray, among: np.ndarray) -> int:
    """Number of the segments `among` that distance alone would keep."""
    some = segments[among]
    return int((~stages.too_far(box, stages.witness(box, some), some)).sum())


def _title(axes: Axes, text: str, lists: list[np.ndarray], total: int) -> None:
    mean = np.mean([len(found) for found in lists])
    axes.set_title(f"{text}: {mean:.1f} of {total} can be nearest, on average")


def _frame(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(False)


def _draw_segments(axes: Axes, segments: np.ndarray, **look: Any) -> None:
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(segments), capstyle="round", **look))


def _pair(place: np.ndarray) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _edges(box: stages.Box, edge: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower corner and size of a box with the whole of its pixels, not their centres alone."""
    half = box.half * edge / (edge - 1)
    return box.centre - half, 2 * half


def _lists(
    axes: Axes, segments: np.ndarray, boxes: list[stages.Box], lists: list[np.ndarray], picked: int, before: np.ndarray
) -> None:
    """Shade boxes by the length of their lists, and show one box with what it keeps of what it was given."""
    from matplotlib.patches import Circle, Rectangle

    edge = stages.CELL if len(boxes) == (PIXELS // stages.CELL) ** 2 else stages.OCTANT
    longest = np.log(max(len(found) for found in lists))
    for box, found in zip(boxes, lists, strict=True):
        corner, size = _edges(box, edge)
        shade = 0.62 * np.log(len(found)) / longest
        axes.add_patch(
            Rectangle(_pair(corner), *size, facecolor=(0.45, 0.6, 0.8, shade), edgecolor="white", linewidth=0.8)
        )
        if edge == stages.CELL:
            axes.text(*_pair(corner + 0.07 * size), str(len(found)), fontsize=7.5, color="0.35", ha="left", va="bottom")
    box, chosen = boxes[picked], lists[picked]
    corner, size = _edges(box, edge)
    y = stages.witness(box, segments[before])
    given = segments[before]
    passed = before[~stages.too_far(box, y, given)]
    _draw_segments(axes, segments, color="0.45", linewidth=1.0)
    _draw_segments(axes, segments[passed], color=PASSED, linewidth=3.2)
    _draw_segments(axes, segments[chosen], color=KEPT, linewidth=3.6)
    axes.add_patch(Rectangle(_pair(corner), *size, fill=False, edgecolor=PICKED, linewidth=2.2))
    cx, cy = box.centre
    for radius in (0.0, 2 * float(np.linalg.norm(box.half))):
        circle = Circle(
            (cx, cy),
            float(np.linalg.norm(y - box.centre)) + radius,
            fill=False,
            edgecolor=PICKED,
            linewidth=1.0,
            linestyle="-" if radius == 0 else (0, (4, 3)),
        )
        axes.add_patch(circle)
    axes.plot(*y, "o", color=PICKED, markersize=5)
    said = f"blue: one {'cell' if edge == stages.CELL else 'octant'}; distance alone keeps {len(passed)} (orange), "
    said += f"with direction {len(chosen)} (red)"
    axes.text(0.0, -0.012, said, transform=axes.transAxes, fontsize=10, color="0.3", va="top")
    axes.set_xlim(-1, 1)
    axes.set_ylim(-1, 1)
    _frame(axes)


def _proof(axes: Axes, segments: np.ndarray, box: stages.Box) -> None:
    """One cell, its witness, and a segment that is dropped: the cell lies on the witness's side of both ends."""
    from matplotlib.patches import Polygon, Rectangle

    c = box.centre
    y = stages.witness(box, segments)
    dropped = stages.is_farther(box, y, segments) & ~stages.too_far(box, y, segments)
    near = stages.closest_points(c, segments)
    # One that distance would keep, and of those the one that shows best: beside the witness, but not too near to it.
    turned = ((near - c) @ (y - c)) / (np.linalg.norm(near - c, axis=1) * np.linalg.norm(y - c))
    number = int(np.where(dropped, np.abs(turned - 0.5), np.inf).argmin())
    ends = segments[number]
    colours = (KEPT, "0.35")
    reach = 4.0
    for x, colour in zip(ends, colours, strict=True):
        middle, away = (x + y) / 2, (x - y) / np.linalg.norm(x - y)
        along = np.array([-away[1], away[0]])
        line = np.array([middle - reach * along, middle + reach * along])
        axes.plot(*line.T, color=colour, linewidth=1.4)
        side = [line[0], line[1], line[1] + reach * away, line[0] + reach * away]
        axes.add_patch(Polygon(side, closed=True, facecolor=colour, alpha=0.08, edgecolor="none"))
    axes.add_patch(
        Rectangle(_pair(c - box.half), *(2 * box.half), facecolor="#dbe7f3", edgecolor=PICKED, linewidth=1.8, zorder=2)
    )
    _draw_segments(axes, segments, color="0.6", linewidth=1.3)
    _draw_segments(axes, segments[number : number + 1], color=KEPT, linewidth=5)
    # The corner of the cell that comes nearest to losing.
    x = ends[int(np.argmin([stages.leads(box, y, end[None])[0] for end in ends]))]
    corners = c + box.half * np.array([[i, j] for i in (-1, 1) for j in (-1, 1)])
    gaps = ((corners - x) ** 2).sum(1) - ((corners - y) ** 2).sum(1)
    p = corners[int(gaps.argmin())]
    for end, colour in ((x, KEPT), (y, PICKED)):
        axes.plot([p[0], end[0]], [p[1], end[1]], color=colour, linewidth=1.5, zorder=3)
    axes.plot(*c, "o", color="black", markersize=5, zorder=4)
    axes.plot(*p, "s", color="black", markersize=5, zorder=4)
    axes.plot(*y, "o", color=PICKED, markersize=7, zorder=4)
    axes.plot(*x, "o", color=KEPT, markersize=7, zorder=4)
    for name, place, offset in (("c", c, (7, -12)), ("p", p, (8, 6)), ("y", y, (9, -4)), ("x", x, (-15, 6))):
        axes.annotate(name, _pair(place), xytext=offset, textcoords="offset points", fontsize=13, fontstyle="italic")
    everything = np.array([c - box.half, c + box.half, *ends, y])
    low, high = everything.min(0), everything.max(0)
    middle, half = (low + high) / 2, 0.62 * (high - low).max()
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_title("3  Why: every pixel of the cell is nearer to y than to T")
    said = "dropped if |p − x|² − |p − y|² > L²/4 for both ends x of T and every p;\n"
    said += f"linear in p, so a corner decides: here {np.linalg.norm(p - x):.3f} against {np.linalg.norm(p - y):.3f}"
    axes.text(0.0, -0.012, said, transform=axes.transAxes, fontsize=10, color="0.3", va="top")
    _frame(axes)


def _values(axes: Axes, segments: np.ndarray, octants: list[stages.Box], lists: list[np.ndarray], step: float) -> None:
    """The signed distances of all pixels, each measured from its octant's list alone, with the zero contour."""
    across = PIXELS // stages.OCTANT
    values = np.empty((PIXELS, PIXELS))
    for number, (octant, found) in enumerate(zip(octants, lists, strict=True)):
        i, j = stages.OCTANT * (number // across), stages.OCTANT * (number % across)
        distances = stages.pixel_distances(octant, step, stages.OCTANT, segments[found])
        values[i : i + stages.OCTANT, j : j + stages.OCTANT] = distances
    at = -1 + step * (np.arange(PIXELS) + 0.5)
    centres = np.stack(np.meshgrid(at, at, indexing="ij"), -1).reshape(-1, 2)
    values = np.where(stages.is_inside(centres, segments).reshape(values.shape), -values, values)
    limit = 2 * float(-values.min())
    axes.imshow(
        values.T,
        origin="lower",
        extent=(-1, 1, -1, 1),
        cmap=colour_map(),
        vmin=-limit,
        vmax=limit,
        interpolation="none",
    )
    axes.contour(at, at, values.T, levels=np.arange(-0.9, 0.91, 0.1), colors="0.2", linewidths=0.4, alpha=0.5)
    axes.contour(at, at, values.T, levels=[0.0], colors="black", linewidths=2.0)
    axes.set_title("4  Voxels are measured from their octant's list alone")
    said = "negative (red) inside; black: the zero contour of the voxels"
    axes.text(0.0, -0.012, said, transform=axes.transAxes, fontsize=10, color="0.3", va="top")
    _frame(axes)


if __name__ == "__main__":
    main()
