"""A figure of a signed distance map: three slices through its middle and its surface, for a talk or a check by eye."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sdm.core.given_values import as_path, whole
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, SDMError
from sdm.io.files.atomic import replacing
from sdm.viz.style import LEVEL_LINE, STYLE, SURFACE_LINE, colour_map
from sdm.viz.surface_drawing import draw_surface

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

FORMATS = ("png", "pdf", "svg", "jpg", "webp")
# The outside reaches much further than the inside is deep: past this ratio the colours stop, and the bar says so.
OUTSIDE_TO_INSIDE = 2.0
# Longer values in the list beside the slices are set smaller.
LONGEST_VALUE = 20


def picture(
    field: SDM,
    path: str | Path,
    *,
    title: str | None = None,
    unit: str | None = None,
    facts: Mapping[str, str] | None = None,
    dpi: int = 120,
) -> None:
    """Draw `field` into a file: its surface, and three orthogonal slices with the surface's contour in black.

    Args:
        field: Any map; one without a surface or one voxel thin is drawn as far as it goes.
        path: Where to; the name's ending says how: `.png`, `.pdf`, `.svg`, `.jpg` or `.webp`. Written atomically.
        title: The headline; the grid's shape if not given.
        unit: The mesh's unit of length for the labels, for example "mm".
        facts: What to list beside the slices, by name; the grid's shape, spacing and the distances' range are there.
        dpi: Pixels per inch of a figure 13.3 inches wide and 7.5 high.

    Negative (red) is inside. Colours are symmetric about zero and end at twice the greatest depth inside
    where the map goes further; slices show voxels as they are, without smoothing. Needs no display.

    Raises:
        FormatError: An ending that is not one of these, or a place that cannot be written.
        SDMError: No map, or no dots.
    """
    target = as_path(path)
    kind = target.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise FormatError(f"{target} does not end like a picture: use one of .{', .'.join(FORMATS)}")
    if not isinstance(field, SDM):
        raise SDMError(f"an object of type {type(field).__name__} is no map: give an SDM")
    if whole(dpi, 1) is None:
        raise SDMError(f"{dpi!r} dots an inch draw nothing: give 1 or more")
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = _figure(field, title or f"Signed distance map, {_times(field.grid.shape)}", unit, dict(facts or {}))
        with replacing(target) as part:
            figure.savefig(part, format=kind, dpi=dpi)


def _figure(field: SDM, title: str, unit: str | None, facts: dict[str, str]) -> Figure:
    # A bare Figure draws with Agg and leaves pyplot's global state and the display alone.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(40 / 3, 7.5), facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(0.03, 0.95, title, fontsize=20, fontweight="bold", color="0.1", va="center")
    values = field.numpy()
    limit, extend = colour_limit(values)

    draw_surface(figure, (0.0, 0.02, 0.5, 0.89), field, unit)
    cells = figure.add_gridspec(2, 2, left=0.575, right=0.975, bottom=0.085, top=0.885, wspace=0.24, hspace=0.27)
    # The places of a technical drawing: the view along z below, those along y and x above it and to the right.
    image = draw_slice(figure.add_subplot(cells[1, 0]), field, values, (0, 1), limit, unit)
    draw_slice(figure.add_subplot(cells[0, 0]), field, values, (0, 2), limit, unit)
    draw_slice(figure.add_subplot(cells[0, 1]), field, values, (1, 2), limit, unit)
    axes = figure.add_subplot(cells[1, 1])
    axes.axis("off")
    _colour_bar(figure, axes, image, extend, unit)
    _list(axes, facts | known_facts(field, values, limit, unit))
    return figure


def colour_limit(values: np.ndarray) -> tuple[float, str]:
    """The symmetric end of the colour scale, and where the map goes past it."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 1.0, "neither"
    low, high = float(finite.min()), float(finite.max())
    reach = max(abs(low), abs(high))
    limit = min(reach, OUTSIDE_TO_INSIDE * -low) if low < 0 < high else reach
    limit = limit if limit > 0 else 1.0
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    return limit, ends[low < -limit, high > limit]


def line_step(limit: float) -> float:
    """A round distance between lines of equal distance: three to seven of them on each side."""
    power = 10.0 ** math.floor(math.log10(limit / 3))
    return power * max(x for x in (1.0, 2.0, 5.0) if x * power <= limit / 3 * 1.0001)


def draw_slice(
    axes: Axes, field: SDM, values: np.ndarray, plane: tuple[int, int], limit: float, unit: str | None
) -> AxesImage:
    """The middle slice that holds the two axes of `plane`: the first to the right, the second up."""
    grid = field.grid
    right, up = plane
    normal = 3 - right - up
    middle = grid.shape[normal] // 2
    cut = np.take(values, middle, axis=normal).T
    names = "xyz" if grid.is_axis_aligned else "ijk"
    start = grid.origin if grid.is_axis_aligned else (0.0, 0.0, 0.0)
    ticks = [start[a] + grid.spacing[a] * np.arange(grid.shape[a]) for a in (right, up)]
    half = [grid.spacing[a] / 2 for a in (right, up)]
    extent = (ticks[0][0] - half[0], ticks[0][-1] + half[0], ticks[1][0] - half[1], ticks[1][-1] + half[1])
    image = axes.imshow(
        cut, cmap=colour_map(), vmin=-limit, vmax=limit, origin="lower", extent=extent, interpolation="none"
    )
    size = (extent[1] - extent[0], extent[3] - extent[2])
    axes.set_aspect("equal" if max(size) < 8 * min(size) else "auto")

    if min(cut.shape) > 1 and np.isfinite(cut).all():
        step = line_step(limit)
        levels = step * np.arange(np.ceil(cut.min() / step), np.floor(cut.max() / step) + 1)
        thin = levels[(levels != 0) & (levels > cut.min()) & (levels < cut.max())]
        if 0 < thin.size < 100:
            axes.contour(*ticks, cut, levels=thin, colors="0.15", linewidths=LEVEL_LINE, alpha=0.4, linestyles="solid")
        if cut.min() < 0 < cut.max():
            axes.contour(*ticks, cut, levels=[0.0], colors="black", linewidths=SURFACE_LINE)
    axes.set_xlabel(names[right] + _in(unit), labelpad=2)
    axes.set_ylabel(names[up] + _in(unit), labelpad=2)
    axes.tick_params(labelsize=8, length=2.5, width=0.6)
    place = start[normal] + grid.spacing[normal] * middle
    # Voxels placed around zero miss it by a rounding, which no reader wants to see.
    place = 0.0 if abs(place) < 1e-6 * grid.spacing[normal] else place
    axes.set_title(f"{names[normal]} = {place:.3g}{' ' + unit if unit else ''}", fontsize=10, color="0.2", pad=5)
    return image


def _colour_bar(figure: Figure, axes: Axes, image: AxesImage, extend: str, unit: str | None) -> None:
    place = axes.inset_axes((0.0, 0.86, 1.0, 0.055))
    bar = figure.colorbar(image, cax=place, orientation="horizontal", extend=extend)
    bar.ax.axvline(0.0, color="black", linewidth=1.5)
    bar.ax.tick_params(labelsize=8, length=2.5, width=0.6)
    bar.ax.set_title(f"signed distance{_in(unit)}", fontsize=10, color="0.2", pad=5)


def known_facts(field: SDM, values: np.ndarray, limit: float, unit: str | None) -> dict[str, str]:
    """Shape, spacing and range of a map by name; lines of equal distance go with `limit`, see `colour_limit`."""
    suffix = f" {unit}" if unit else ""
    spacing = field.grid.spacing
    steps = f"{spacing[0]:.4g}" if len(set(spacing)) == 1 else _times(tuple(f"{s:.4g}" for s in spacing))
    known = {"grid": _times(field.grid.shape), "voxel": f"{steps}{suffix}"}
    finite = values[np.isfinite(values)]
    if finite.size:
        known["distances"] = f"{finite.min():.3g} to {finite.max():.3g}{suffix}".replace("-", "\N{MINUS SIGN}")
        known["lines"] = f"every {line_step(limit):g}{suffix}"
    return known | {"sign": "negative inside"}


def _list(axes: Axes, lines: dict[str, str]) -> None:
    step = min(0.1, 0.72 / len(lines))
    for row, (name, value) in enumerate(lines.items()):
        y = 0.66 - step * row
        axes.text(0.0, y, name, transform=axes.transAxes, fontsize=11, color="0.45", va="center")
        size = max(6.0, min(11.0, 11.0 * LONGEST_VALUE / max(1, len(value))))
        axes.text(0.36, y, value, transform=axes.transAxes, fontsize=size, color="0.1", va="center")


def _in(unit: str | None) -> str:
    return f" [{unit}]" if unit else ""


def _times(shape: tuple[object, ...]) -> str:
    return " × ".join(str(n) for n in shape)
