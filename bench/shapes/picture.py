"""Picture of the study of shape models: compactness, generalisation, specificity."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sdm.io.files.atomic import replacing
from sdm.viz.style import STYLE

NAMES = {"points": "points laid by a template", "maps": "signed distance maps"}


def draw(record: dict[str, Any], path: Path) -> None:
    """Write the three curves of both models."""
    modes = record["modes"]
    with rc_context(STYLE):
        figure = Figure(figsize=(10.5, 3.3), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        left, middle, right = figure.subplots(1, 3)
        for key, name in NAMES.items():
            curve = record["curves"][key]
            shares = [100 * x for x in curve["compactness"]]
            left.plot(range(1, len(shares) + 1), shares, label=name)
            middle.plot(modes, curve["generalisation"], marker="o", label=name)
            right.plot(modes, curve["specificity"], marker="o", label=name)
        left.set(title="compactness", xlabel="modes", ylabel="share of variance [%]")
        middle.set(
            title="generalisation (leave one out)", xlabel="modes", ylabel="surface distance [mm]", ylim=(0, None)
        )
        right.set(title="specificity", xlabel="modes", ylabel="distance from the nearest atrium [mm]", ylim=(0, None))
        left.legend(fontsize=8)
        with replacing(path) as part:
            figure.savefig(part, format="png")
