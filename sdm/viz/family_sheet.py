"""Sheet of a family's shapes, lit and side by side."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from sdm.errors import FormatError
from sdm.io.files.atomic import replacing
from sdm.viz.figure import FORMATS
from sdm.viz.style import STYLE

COLUMNS = 6
# Towards the eye, and the light over its left shoulder.
EYE, LIGHT = (35.0, -60.0), (55.0, -105.0)
COLOUR = np.array([0.86, 0.45, 0.38])


def family_sheet(
    shapes: list[tuple[np.ndarray, np.ndarray]], captions: list[str], path: Path, *, title: str | None = None
) -> None:
    """Write a sheet of shapes, all at one scale.

    Args:
        shapes: Vertices (V,3) and faces (F,3) of each.
        captions: A line under each.
        path: .png, .pdf, .svg, .jpg or .webp.
        title: A line over all.

    Raises:
        FormatError: Another ending, or the file cannot be written.
    """
    check_picture(path)
    rows = math.ceil(len(shapes) / COLUMNS)
    right, up, _ = _axes(EYE)
    flat = np.stack([right, up]).T
    reach = max(float(np.ptp(v.astype(np.float64) @ flat, axis=0).max()) for v, _ in shapes) * 0.54
    with rc_context(STYLE):
        figure = Figure(figsize=(2.2 * min(COLUMNS, len(shapes)), 2.4 * rows), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        places = np.atleast_1d(figure.subplots(rows, min(COLUMNS, len(shapes)))).reshape(-1)
        for place in places:
            place.set_axis_off()
        for place, (vertices, faces), caption in zip(places, shapes, captions, strict=False):
            draw_shape(place, vertices, faces, reach, caption)
        if title:
            figure.suptitle(title, fontsize=11)
        with replacing(path) as part:
            figure.savefig(part, format=path.suffix[1:].lower())


def draw_shape(place: Axes, vertices: np.ndarray, faces: np.ndarray, reach: float, caption: str) -> None:
    """Draw a shape in the middle of `place`, which shows `reach` to each side of it."""
    right, up, eye = _axes(EYE)
    points = vertices.astype(np.float64)
    xy = points @ np.stack([right, up]).T
    colours, order = _lit(points, faces, points @ eye, eye)
    place.add_collection(PolyCollection(list(xy[faces[order]]), facecolors=colours, edgecolors=colours, linewidths=0.3))
    middle = (xy.max(0) + xy.min(0)) / 2
    place.set(xlim=(middle[0] - reach, middle[0] + reach), ylim=(middle[1] - reach, middle[1] + reach))
    place.set_aspect("equal")
    place.set_title(caption, fontsize=9, y=-0.05)


def check_picture(path: Path) -> None:
    """Refuse a path that does not end like a picture.

    Raises:
        FormatError: Another ending.
    """
    if path.suffix[1:].lower() not in FORMATS:
        raise FormatError(f"{path} does not end like a picture: use .{', .'.join(FORMATS)}")


def _lit(vertices: np.ndarray, faces: np.ndarray, depth: np.ndarray, eye: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours (N,3) of the faces that face the eye, and their numbers, far ones first."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    seen = np.flatnonzero(normals @ eye > 0)
    order = seen[np.argsort(depth[faces[seen]].mean(1))]
    light = _direction(*LIGHT)
    bright = 0.38 + 0.62 * np.clip(normals[order] @ light, 0, 1)
    return np.clip(COLOUR * bright[:, None], 0, 1), order


def _axes(place: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    eye = _direction(*place)
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    return right, np.cross(eye, right), eye


def _direction(elevation: float, azimuth: float) -> np.ndarray:
    up, around = math.radians(elevation), math.radians(azimuth)
    return np.array([math.cos(up) * math.cos(around), math.cos(up) * math.sin(around), math.sin(up)])
