"""Picture of a surrogate's card: slices of a map and its error at the worst place found, and error by place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sdm.io.files.atomic import replacing
from sdm.viz.style import OCHRE, STYLE, SURFACE_LINE, colour_map


def card_sheet(exact: np.ndarray, guess: np.ndarray, card: dict[str, Any], path: Path, *, title: str) -> None:
    """Write the picture.

    Args:
        exact: Exact map (nx,ny,nz) at the place of least Dice.
        guess: The surrogate's.
        card: By `measure_card`.
        path: .png.
        title: A line over all.
    """
    inside = np.argwhere(exact < 0)
    layer = int(np.median(inside[:, 2])) if len(inside) else exact.shape[2] // 2
    limit = float(np.abs(exact).max())
    error = np.abs(guess - exact)[:, :, layer].T
    with rc_context(STYLE):
        figure = Figure(figsize=(11.5, 3.4), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        left, middle, right = figure.subplots(1, 3)
        left.imshow(exact[:, :, layer].T, origin="lower", cmap=colour_map(), vmin=-limit, vmax=limit)
        for values, colour, name in ((exact, "black", "exact"), (guess, OCHRE, "surrogate")):
            left.contour(values[:, :, layer].T, levels=[0.0], colors=colour, linewidths=SURFACE_LINE)
            left.plot([], [], color=colour, label=name)
        left.legend(fontsize=8)
        left.set_title(f"least Dice found: {card['worst']['dice']['dice']:.4f}")
        image = middle.imshow(error, origin="lower", cmap="magma")
        figure.colorbar(image, ax=middle, shrink=0.8)
        middle.set_title("its absolute error")
        for place in (left, middle):
            place.set(xticks=[], yticks=[])
        bins = card["by_distance_from_centre"]
        right.bar([(b["from"] + b["to"]) / 2 for b in bins], [b["mean"] for b in bins], width=0.16)
        right.set(xlabel="distance from the box's centre (1 is its border)", ylabel="mean absolute error", xlim=(0, 1))
        right.set_title(f"{card['fresh']} fresh shapes: {card['mean']:.3g} on average")
        figure.suptitle(title, fontsize=10)
        with replacing(path) as part:
            figure.savefig(part, format="png")
