"""Style of the benchmarks' figures: one style, one colour for each library, axes whose ticks can be read aloud."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from sdm.io.files.atomic import replacing
from sdm.viz import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OURS = "sdm"
# sdm stands out; the others are told apart by lightness too, for those who do not see the hues.
COLOURS = {
    OURS: style.RED,
    "Warp winding number": style.BLUE,
    "Warp winding number, SAH": "#3f4f9e",
    "Warp swept volume": "#6fa8d6",
    "libigl winding number": style.GREEN,
    "libigl pseudonormal": "#8cc39a",
    "Open3D": style.VIOLET,
    "point-cloud-utils": style.OCHRE,
    "trimesh + embreex": style.GREY,
}
SPARE = ("#444444", "#a0a0a0", "#d08a9a", "#5fb3b3")
MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")
# Charts of a whole slide: the style of all drawings, in larger letters and without a frame.
STYLE: dict[Any, Any] = {
    **style.STYLE,
    "font.size": 12.0,
    "axes.titlesize": 16.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 14.0,
    "axes.linewidth": 0.8,
    "axes.edgecolor": "0.45",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "0.88",
    "grid.linewidth": 0.8,
    "lines.linewidth": 2.4,
    "lines.markersize": 7.0,
    "legend.fontsize": 11.0,
}


def colour_of(name: str, others: list[str]) -> str:
    """A library's colour, the same in every figure; a user's own peers get spare ones in order."""
    unknown = [other for other in others if other not in COLOURS]
    return COLOURS.get(name) or SPARE[unknown.index(name) % len(SPARE)]


@contextmanager
def drawing(path: Path, caption: str, size: tuple[float, float] = (12.0, 6.75)) -> Iterator[tuple[Figure, Axes]]:
    """A figure with one pair of axes, written to `path` at the end; `caption` says below it what was measured on."""
    with sheet(path, size, dpi=150, look=STYLE) as figure:
        axes = figure.add_axes((0.085, 0.145, 0.885, 0.755))
        yield figure, axes
        # About fifteen letters of this size to an inch.
        lines = textwrap.fill(caption, int(15 * size[0]))
        figure.text(0.012, 0.016, lines, fontsize=8.5, color="0.45", va="bottom")


@contextmanager
def sheet(
    path: Path,
    size: tuple[float, float],
    dpi: int,
    layout: Literal["constrained"] | None = None,
    look: dict[Any, Any] = style.STYLE,
) -> Iterator[Figure]:
    """An empty figure in a style, written to `path` at the end, whole or not at all; no display is needed."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(look):
        figure = Figure(figsize=size, facecolor="white", layout=layout)
        FigureCanvasAgg(figure)
        yield figure
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            figure.savefig(part, format="png", dpi=dpi)


def log_axes(axes: Axes, *, x: bool = True, y: bool = True) -> None:
    """Logarithmic axes, with thin lines at the decades."""
    if x:
        axes.set_xscale("log")
    if y:
        axes.set_yscale("log")
        axes.grid(visible=True, axis="y")
    if x:
        axes.grid(visible=True, axis="x")


def plain_ticks(axis: Any, form: str | None = None) -> None:
    """Numbers as a reader would say them, not powers of ten."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_major_formatter(
        FuncFormatter(lambda value, _: (form or ("{:,.0f}" if value >= 1 else "{:g}")).format(value))
    )
    axis.set_minor_formatter(NullFormatter())


def short(count: float) -> str:
    """1000 as 1k, 1000000 as 1M."""
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if count >= size:
            return f"{count / size:.3g}{unit}"
    return f"{count:.3g}"


def guide(axes: Axes, at: tuple[float, float], end: float, slope: float, text: str) -> None:
    """A dotted line of a given slope from `at` to x = `end` in log-log axes, named at its end."""
    x, y = at
    top = y * (end / x) ** slope
    axes.plot([x, end], [y, top], color="0.55", linewidth=1.4, linestyle=(0, (1, 2)), zorder=1)
    axes.annotate(text, (end, top), xytext=(6, 0), textcoords="offset points", fontsize=10.5, color="0.45", va="center")
