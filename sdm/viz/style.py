"""One style for all drawings: letters, lines and colours, which those who see no red or green tell apart too.

`with matplotlib.rc_context(STYLE): ...`, or `matplotlib.rcParams.update(STYLE)` in a script of your own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.colors import LinearSegmentedColormap

# Low values, the inside, are red: the colour of surfaces beside the slices.
MAP_COLOURS = ("#8c1d2c", "#c9453f", "#ea8a6c", "#f8c9b0", "#f8f7f5", "#c3dcec", "#80b5d8", "#3f86bd", "#1f5a96")
# Lines, points and bars, in the order in which they are taken: what the figure is about first.
RED, BLUE, GREEN, OCHRE, VIOLET, GREY = PALETTE = ("#c2341d", "#1f5a96", "#3b7d4f", "#b8862b", "#8a5ba6", "#777777")
# The surface in a slice, and lines of equal distance.
SURFACE_LINE, LEVEL_LINE = 1.5, 0.35

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 10.0,
    "axes.prop_cycle": f"cycler(color={list(PALETTE)})",
    "axes.linewidth": 0.6,
    "axes.edgecolor": "0.35",
    "axes.labelcolor": "0.2",
    "axes.axisbelow": True,
    "xtick.color": "0.35",
    "ytick.color": "0.35",
    "grid.color": "0.84",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.8,
    "legend.frameon": False,
    "svg.fonttype": "none",
}


def colour_map() -> LinearSegmentedColormap:
    """Colours of signed distances: red inside, blue outside."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("inside_outside", MAP_COLOURS)
