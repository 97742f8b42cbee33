"""A figure of one cochlea: its exact map, the surrogate's, and the difference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sdm.core.signed_distance_map import SDM
from sdm.io.files.atomic import replacing
from sdm.viz.style import STYLE, SURFACE_LINE, colour_map

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Ends of the colour scales [mm]: of the maps, and least of the difference.
MAP_MM, ERROR_MM = 1.5, 0.02
ROWS = ((0, 1), (0, 2))
NAMES = "xyz"


def side_by_side(exact: SDM, predicted: SDM, path: Path, *, title: str, dpi: int = 120) -> None:
    """Draw two maps of one grid and their difference, in two slices that hold the most of the inside.

    Args:
        exact: The exact map [mm].
        predicted: The surrogate's.
        path: File to write, .png or what else Matplotlib can; written atomically.
        title: The headline.
        dpi: Pixels per inch of a figure 13.3 inches wide and 7.5 high.

    The exact surface is black, the predicted one dashed.

    Raises:
        FormatError: A place that cannot be written.
    """
    import matplotlib as mpl

    with mpl.rc_context(STYLE), replacing(path) as part:
        _figure(exact, predicted, title).savefig(part, format=path.suffix.lstrip("."), dpi=dpi)


def _figure(exact: SDM, predicted: SDM, title: str) -> Figure:
    # A bare Figure draws with Agg and leaves pyplot's global state and the display alone.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(40 / 3, 7.5), facecolor="white")
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained", rect=(0.015, 0.02, 0.97, 0.9), hspace=0.08, wspace=0.06)
    figure.text(0.03, 0.95, title, fontsize=20, fontweight="bold", color="0.1", va="center")
    wanted, found = exact.numpy(), predicted.numpy()
    error = found - wanted
    end = max(float(np.quantile(np.abs(error), 0.99)), ERROR_MM)
    cells = figure.add_gridspec(2, 3)
    columns = (("exact", wanted, MAP_MM), ("surrogate", found, MAP_MM), ("surrogate - exact", error, end))
    for row, plane in enumerate(ROWS):
        normal = 3 - sum(plane)
        inside = (wanted < 0).sum(plane)
        at = int(np.argmax(inside))
        sides = [exact.grid.origin[k] + exact.grid.spacing[k] * np.arange(exact.grid.shape[k]) for k in plane]
        for column, (name, values, limit) in enumerate(columns):
            axes = figure.add_subplot(cells[row, column])
            cut = np.take(values, at, normal).T
            half = exact.grid.spacing[0] / 2
            extent = (sides[0][0] - half, sides[0][-1] + half, sides[1][0] - half, sides[1][-1] + half)
            shown = axes.imshow(cut, origin="lower", extent=extent, cmap=colour_map(), vmin=-limit, vmax=limit)
            axes.contour(*sides, np.take(wanted, at, normal).T, [0], colors="k", linewidths=SURFACE_LINE)
            axes.contour(
                *sides, np.take(found, at, normal).T, [0], colors="k", linewidths=SURFACE_LINE, linestyles="dashed"
            )
            axes.set_xlabel(f"{NAMES[plane[0]]} [mm]")
            axes.set_ylabel(f"{NAMES[plane[1]]} [mm]")
            where = exact.grid.origin[normal] + exact.grid.spacing[normal] * at
            axes.set_title(f"{name}, {NAMES[normal]} = {where:.1f} mm", fontsize=10)
            # As high as the slice, whatever its shape.
            figure.colorbar(shown, cax=axes.inset_axes((1.03, 0.0, 0.04, 1.0)), label="[mm]")
    return figure
