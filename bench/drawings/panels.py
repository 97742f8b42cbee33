"""Rows of drawings without axes, in the benchmarks' style."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdm.bench.common.figure import STYLE, sheet

if TYPE_CHECKING:
    import numpy as np

INSIDE, OUTSIDE, DOUBT = "#c9453f", "#80b5d8", "#e8a33d"
INK, GREY = "0.15", "0.62"


@contextmanager
def panels(
    path: Path, rows: int, columns: int, size: tuple[float, float], title: str, *, dpi: int = 110
) -> Iterator[np.ndarray]:
    """Axes (rows, columns) under a headline, written to `path` at the end."""
    look = {
        **STYLE,
        "figure.constrained_layout.h_pad": 0.09,
        "font.size": 11.0,
        "axes.titlesize": 11.5,
        "axes.titlepad": 7.0,
    }
    with sheet(path, size, dpi=dpi, layout="constrained", look=look) as figure:
        figure.suptitle(title, x=0.01, ha="left", fontsize=16, fontweight="bold")
        grid: Any = figure.subplots(rows, columns, squeeze=False)
        for axes in grid.flat:
            axes.set_xticks([])
            axes.set_yticks([])
            for side in axes.spines.values():
                side.set_visible(False)
        yield grid
