"""Sample numbers of a stream: the same sixteen samples by one process, by two, by four, and after a restart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sdm.bench.drawings.panels import INK, panels

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RANKS = ("#1f5a96", "#c9453f", "#3b7d4f", "#b8862b")
SAMPLES = 16


def owner(number: int, ranks: int, batch: int) -> int:
    """The rank that makes a sample: `SDMStream`'s rule."""
    return number // batch % ranks


def draw_samples(path: Path) -> None:
    """A row of numbered samples for each way to run the same stream."""
    ways = [
        ("one process, batches of 8", [(0, SAMPLES, 1, 8)]),
        ("two processes, batches of 4 each", [(0, SAMPLES, 2, 4)]),
        ("four processes, batches of 2 each", [(0, SAMPLES, 4, 2)]),
        ("two processes, killed after 8 samples; then four go on", [(0, 8, 2, 4), (8, SAMPLES, 4, 2)]),
    ]
    with panels(path, 1, 1, (11.0, 4.4), "Sample 5 is sample 5") as grid:
        axes = grid[0, 0]
        for row, (name, runs) in enumerate(ways):
            axes.text(0, -row + 0.42, name, color=INK, fontsize=11.5, va="bottom")
            for begin, end, ranks, batch in runs:
                for number in range(begin, end):
                    _cell(axes, number, row, RANKS[owner(number, ranks, batch)])
                for edge in range(begin + ranks * batch, end, ranks * batch):
                    axes.plot([edge, edge], [-row - 0.42, -row + 0.4], color=INK, linewidth=1.4)
        axes.plot([8, 8], [-3.5, -2.5], color=INK, linewidth=1.4, linestyle=(0, (2, 2)))
        for rank, colour in enumerate(RANKS):
            axes.plot([], [], "s", color=colour, markersize=11, label=f"rank {rank}")
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.01), ncols=4)
        axes.text(SAMPLES, -3.95, "lines: steps of the training", ha="right", color="0.4", fontsize=10.5)
        axes.set_xlim(-0.1, SAMPLES + 0.1)
        axes.set_ylim(-3.6, 0.85)


def _cell(axes: Axes, number: int, row: int, colour: str) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((number + 0.06, -row - 0.32), 0.88, 0.64, color=colour, linewidth=0))
    axes.text(number + 0.5, -row, str(number), color="white", ha="center", va="center", fontsize=11.5, weight="bold")
