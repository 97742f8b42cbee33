"""Colour bar of a plane, as a picture beside the controls."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import UInt8

from sdm.viz.style import STYLE, colour_map

INCHES, DPI = (3.4, 0.78), 200


@lru_cache(maxsize=8)
def colour_bar(
    limit: float, centre: float, step: float | None, quantity: str, unit: str, grey: bool = False
) -> UInt8[np.ndarray, "h w 3"]:
    """The colours from `centre - limit` to `centre + limit`, with the unit; `step` is that of the lines, if any."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=INCHES, dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        place = figure.add_axes((0.06, 0.42, 0.88, 0.2))
        colours = ScalarMappable(Normalize(centre - limit, centre + limit), "gray" if grey else colour_map())
        bar = figure.colorbar(colours, cax=place, orientation="horizontal")
        if step is not None:
            bar.ax.axvline(centre, color="black", linewidth=1.5)
        bar.ax.tick_params(labelsize=8, length=2.5, width=0.6)
        lines = "" if step is None else f", a line every {step:g}"
        title = f"{quantity}{f' [{unit}]' if unit else ''}{lines}"
        bar.ax.set_title(title, fontsize=9, color="0.2", pad=4)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()
