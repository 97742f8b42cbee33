"""Three tests that drop triangles, in the plane: witness bound, normal cone, Voronoi regions."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sdm.bench.drawings.panels import DOUBT, GREY, INK, INSIDE, OUTSIDE, panels

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KEPT, DROPPED, BOX = INSIDE, "0.72", "#1f5a96"


def least_lead(centre: np.ndarray, half: np.ndarray, witness: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The least of |p - x|^2 - |p - y|^2 over the voxels p of a box, for points x (N,2) and a witness y."""
    away = ((points - centre) ** 2).sum(-1) - ((witness - centre) ** 2).sum()
    return away - 2 * (half * np.abs(points - witness)).sum(-1)


def draw_culling(path: Path) -> None:
    """Three panels."""
    with panels(path, 1, 3, (13.0, 5.0), "Three tests that drop what cannot be nearest") as grid:
        _witness(grid[0, 0])
        _cone(grid[0, 1])
        _voronoi(grid[0, 2])
        for axes in grid.flat:
            axes.set_aspect("equal")


def _box(axes: Axes, centre: tuple[float, float], half: float, text: str) -> None:
    from matplotlib.patches import Rectangle

    corner = (centre[0] - half, centre[1] - half)
    axes.add_patch(Rectangle(corner, 2 * half, 2 * half, facecolor="#dce8f3", edgecolor=BOX, linewidth=1.6))
    axes.text(centre[0], centre[1], text, ha="center", va="center", color=BOX, fontsize=10)


def _wave(count: int = 46) -> np.ndarray:
    x = np.linspace(-2.6, 2.6, count)
    return np.stack([x, 0.35 * np.cos(1.9 * x) - 0.12 * x**2], -1)


def _witness(axes: Axes) -> None:
    line, centre, half = _wave(), np.array([0.15, 1.5]), np.array([0.42, 0.42])
    nearest = line[((line - centre) ** 2).sum(-1).argmin()]
    kept = least_lead(centre, half, nearest, line) <= 0
    witness = (float(nearest[0]), float(nearest[1]))
    axes.plot(*line.T, color=DROPPED, linewidth=2.2)
    run = np.where(kept)[0]
    axes.plot(*line[run[0] : run[-1] + 1].T, color=KEPT, linewidth=4.0)
    _box(axes, (0.15, 1.5), 0.42, "voxels")
    axes.plot(*witness, "o", color=INK, markersize=7)
    axes.annotate("witness", witness, (1.0, 0.75), color=INK, arrowprops={"arrowstyle": "-", "color": GREY})
    axes.text(-1.9, -1.35, "dropped: further from\nevery voxel than the witness", ha="left", color="0.45", fontsize=10)
    axes.text(-2.3, 0.75, "kept", color=KEPT, fontsize=11, weight="bold")
    axes.annotate(
        "",
        (float(line[run[1], 0]), float(line[run[1], 1])),
        (-1.75, 0.8),
        arrowprops={"arrowstyle": "-", "color": KEPT},
    )
    axes.set_title("1  Witness bound", loc="left")
    axes.set_xlim(-2.7, 2.7)
    axes.set_ylim(-2.3, 2.3)


def _cone(axes: Axes) -> None:
    from matplotlib.patches import Wedge

    origin, spread = np.array([-0.3, -0.9]), 31
    for turn in (0, 180):
        axes.add_patch(
            Wedge(tuple(origin), 3.4, 90 + turn - spread, 90 + turn + spread, facecolor=DOUBT, alpha=0.25, linewidth=0)
        )
    x = np.linspace(-1.0, 0.4, 5)
    faces = np.stack([x, -0.9 + 0.13 * np.array([-1.1, 0.3, 0.55, 0.35, -0.9])], -1)
    axes.plot(*faces.T, color=KEPT, linewidth=4.0)
    for a, b in itertools.pairwise(faces):
        along = (b - a) / np.hypot(*(b - a))
        axes.annotate(
            "",
            tuple((a + b) / 2 + 0.55 * np.array([-along[1], along[0]])),
            tuple((a + b) / 2),
            arrowprops={"arrowstyle": "->", "color": INK},
        )
    _box(axes, (0.0, 1.35), 0.5, "kept")
    _box(axes, (2.1, 0.2), 0.5, "dropped")
    axes.text(
        1.2, -0.95, "some faces, and the\ncone of their normals", ha="left", va="center", color="0.45", fontsize=10
    )
    axes.set_title("2  Normal cone", loc="left")
    axes.set_xlim(-2.7, 2.7)
    axes.set_ylim(-2.3, 2.3)


def _voronoi(axes: Axes) -> None:
    corners = np.array([[-1.0, -0.75], [1.25, -0.6], [-0.1, 0.85]])
    reach = 1.35
    from matplotlib.patches import Polygon, Wedge

    for i in range(3):
        a, b = corners[i], corners[(i + 1) % 3]
        along = (b - a) / np.hypot(*(b - a))
        out = np.array([along[1], -along[0]]) * reach
        axes.add_patch(Polygon([a, b, b + out, a + out], facecolor=OUTSIDE, alpha=0.3, linewidth=0))
        before = corners[i] - corners[i - 1]
        first = math.degrees(math.atan2(-before[0], before[1]))
        last = math.degrees(math.atan2(-along[0], along[1]))
        axes.add_patch(Wedge(tuple(a), reach, first, last, facecolor=DOUBT, alpha=0.3, linewidth=0))
        middle = (a + b) / 2 + out * 0.6
        axes.text(middle[0], middle[1], "edge", ha="center", va="center", color=BOX, fontsize=10)
        turn = math.radians((first + (last if last > first else last + 360)) / 2)
        corner = a + 0.85 * np.array([math.cos(turn), math.sin(turn)])
        axes.text(corner[0], corner[1], "corner", ha="center", va="center", fontsize=10)
    axes.add_patch(Polygon(list(corners), facecolor=KEPT, alpha=0.35, edgecolor=INK, linewidth=1.8))
    middle = corners.mean(0)
    axes.text(middle[0], middle[1], "face", ha="center", va="center", color=INK, fontsize=11, weight="bold")
    axes.set_title("3  Voronoi regions of a triangle", loc="left")
    axes.set_xlim(-2.7, 2.7)
    axes.set_ylim(-2.3, 2.3)
