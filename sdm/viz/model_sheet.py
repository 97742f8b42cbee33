"""Sheet of a shape model: its mean, its modes at both ends, and its three curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sdm.io.files.atomic import replacing
from sdm.viz.family_sheet import draw_shape
from sdm.viz.style import STYLE

CURVES = ("compactness", "generalisation", "specificity")


def model_sheet(
    shapes: Sequence[tuple[np.ndarray, np.ndarray] | None],
    facts: dict[str, Any],
    path: Path,
    *,
    title: str | None = None,
) -> None:
    """Write the sheet of a model.

    Args:
        shapes: Vertices (V,3) and faces (F,3): the mean, then each mode's lower and upper end; None of one without a
            surface.
        facts: `compactness`, and, where they are known, `generalisation` and `specificity`.
        path: .png, .pdf, .svg, .jpg or .webp.
        title: A line over all.
    """
    pairs = (len(shapes) - 1) // 2
    curves = [name for name in CURVES if facts.get(name)]
    columns = max(pairs + 1, len(curves))
    reach = max((float(np.ptp(v, axis=0).max()) for v, _ in filter(None, shapes)), default=1.0) * 0.6
    with rc_context(STYLE):
        figure = Figure(figsize=(2.7 * columns, 7.2), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        places = figure.subplots(3, columns, squeeze=False)
        for place in places.reshape(-1):
            place.set_axis_off()
        _draw(places[0, 0], shapes[0], reach, "mean")
        for mode in range(pairs):
            for row, end in ((0, "lower end"), (1, "upper end")):
                _draw(places[row, mode + 1], shapes[1 + 2 * mode + row], reach, f"mode {mode + 1}, {end}")
        for place, name in zip(places[2], curves, strict=False):
            place.set_axis_on()
            if name == "compactness":
                place.plot(range(1, len(facts[name]) + 1), [100 * x for x in facts[name]], "o-", markersize=3)
                place.set_ylabel("share of variance [%]")
            else:
                place.plot(facts[name]["modes"], facts[name]["mean"], "o-", markersize=3)
                place.set_ylabel("mean vertex distance")
            place.set(title=name, xlabel="modes", ylim=(0, None))
            place.xaxis.get_major_locator().set_params(integer=True)
        if title:
            figure.suptitle(title, fontsize=11)
        with replacing(path) as part:
            figure.savefig(part, format=path.suffix[1:].lower())


def _draw(place: Axes, shape: tuple[np.ndarray, np.ndarray] | None, reach: float, label: str) -> None:
    if shape is not None:
        draw_shape(place, *shape, reach, label)
        return
    place.text(0.5, 0.5, f"{label}:\nno surface", ha="center", va="center", transform=place.transAxes)
