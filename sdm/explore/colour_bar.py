"""Colour bar of a plane, as a picture beside the controls."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import UInt8

from sdm.viz.figure import STYLE, colour_map

INCHES, DPI = (3.4, 0.78), 200


@lru_cache(maxsize=8)
def colour_bar(limit: float, centre: float, step: float, quantity: str, unit: str) -> UInt8[np.ndarray, "h w 3"]:
    """The colours from `centre - limit` to `centre + limit`, with the unit, and a line at each `step`."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=INCHES, dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        place = figure.add_axes((0.06, 0.42, 0.88, 0.2))
        colours = ScalarMappable(Normalize(centre - limit, centre + limit), colour_map())
        bar = figure.colorbar(colours, cax=place, orientation="horizontal")
        bar.ax.axvline(centre, color="black", linewidth=1.5)
        bar.ax.tick_params(labelsize=8, length=2.5, width=0.6)
        title = f"{quantity}{f' [{unit}]' if unit else ''}, a line every {step:g}"
        bar.ax.set_title(title, fontsize=9, color="0.2", pad=4)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()
