"""Three slices of a map side by side: for notebooks, and for a look in between."""

from __future__ import annotations

import base64
import io
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sdm.core.signed_distance_map import SDM
from sdm.inspect.facts_table import facts_table
from sdm.viz.figure import colour_limit, draw_slice, known_facts
from sdm.viz.style import STYLE

# Of the picture in a notebook, small enough to be kept in it.
SMALL: dict[str, Any] = {"figsize": (7.2, 2.5), "dpi": 60}


class SliceFigure(Figure):
    """A matplotlib figure that notebooks show without pyplot."""

    def _repr_png_(self) -> bytes:
        return self.png()

    def png(self) -> bytes:
        """The picture as a PNG file's bytes."""
        file = io.BytesIO()
        with rc_context(STYLE):
            self.savefig(file, format="png", dpi=self.dpi)
        return file.getvalue()


def slices_figure(
    field: SDM, unit: str | None = None, *, figsize: tuple[float, float] = (13.0, 4.2), dpi: int = 100
) -> SliceFigure:
    """A figure of the map's three middle slices, across z, y and x.

    Args:
        field: Any map.
        unit: The mesh's unit of length for the labels, for example "mm".
        figsize: Width and height in inches.
        dpi: Pixels per inch.

    Returns:
        A `matplotlib.figure.Figure`; red is inside, the surface is a black line. Needs no display.
    """
    with rc_context(STYLE):
        figure = SliceFigure(figsize=figsize, dpi=dpi, facecolor="white", layout="constrained")
        FigureCanvasAgg(figure)
        values = field.numpy()
        limit, extend = colour_limit(values)
        axes = figure.subplots(1, 3)
        images = [
            draw_slice(place, field, values, plane, limit, unit)
            for place, plane in zip(axes, ((0, 1), (0, 2), (1, 2)), strict=True)
        ]
        bar = figure.colorbar(images[0], ax=list(axes), extend=extend, shrink=0.85)
        bar.ax.tick_params(labelsize=8)
    return figure


def map_html(field: SDM) -> str:
    """A small picture of a map, and its facts, for notebooks."""
    values = field.numpy()
    facts: dict[str, object] = dict(known_facts(field, values, colour_limit(values)[0], None))
    facts |= {"inside": f"{field.inside_voxels:,} voxels", "device": str(field.device)}
    if field.ambiguous_voxels:
        facts["ambiguous"] = f"{field.ambiguous_voxels:,} voxels"
    if field.sign not in (None, "winding"):
        facts["sign"] = "none: unsigned" if field.sign == "none" else f"by {field.sign}, negative inside"
    picture = base64.b64encode(slices_figure(field, **SMALL).png()).decode()
    table = facts_table("Signed distance map", facts)
    return f'<div>{table}<img alt="three slices" src="data:image/png;base64,{picture}"></div>'
