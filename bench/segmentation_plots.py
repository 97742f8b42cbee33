"""Pictures of both studies of segmentation, from their logs: `python -m bench.segmentation_plots [--out docs]`."""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path
from typing import Any

from bench import segmentation_juhl, segmentation_ma
from bench._figure import COLOURS, OURS, drawing
from bench._segmentation_jobs import read_logs
from bench.segmentation_report import differences, half_width, protocol, values_of
from sdm.segmentation import METHODS

# Contour Dice of K. Juhl et al., MIDL 2019 [%].
PUBLISHED = {"pwc nearest": 68.49, "pwr-voxels linear": 87.69}
FAMILIES = {
    "other losses": ("boundary", "hausdorff", "sdf-product", "hausdorff-foreground"),
    "a head": tuple(name for name in METHODS if name.startswith("head-")),
    "a branch": tuple(name for name in METHODS if name.startswith("branch-")),
    "regression": ("pwr",),
}
HUES = ("#777777", COLOURS["Warp winding number"], COLOURS["libigl winding number"], COLOURS[OURS])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ma", type=Path, default=segmentation_ma.LOGS)
    parser.add_argument("--juhl", type=Path, default=segmentation_juhl.LOGS)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    options = parser.parse_args()
    if logs := read_logs(options.juhl):
        draw_shapes(logs, options.out / "segmentation-shapes.png")
    if logs := read_logs(options.ma):
        draw_atrium(logs, options.out / "segmentation-atrium.png")


def draw_shapes(logs: list[dict[str, Any]], target: Path) -> None:
    """Contour Dice of every row, one dot for each seed, and what was published."""
    found: dict[str, list[float]] = {}
    for log in logs:
        for way in ("nearest", "linear"):
            name = f"{log['job']['network']} {way}"
            found.setdefault(name, []).append(100 * statistics.fmean(row["contour_dice"] for row in log[way]))
    rows = [name for name in segmentation_juhl.ROWS if name in found][::-1]
    with drawing(target, protocol(logs), (12.0, 5.2)) as (_, axes):
        axes.set_position((0.40, 0.20, 0.57, 0.66))
        axes.margins(x=0.08)
        for at, name in enumerate(rows):
            hue = COLOURS[OURS] if name.startswith("pwr") else COLOURS["Warp winding number"]
            axes.plot(found[name], [at] * len(found[name]), "o", color=hue, alpha=0.45)
            axes.plot(statistics.fmean(found[name]), at, "|", color=hue, markersize=26, markeredgewidth=3)
            if name in PUBLISHED:
                axes.plot(PUBLISHED[name], at, "D", color="0.25", markersize=7, fillstyle="none")
                axes.annotate("published", (PUBLISHED[name], at), xytext=(0, 12), textcoords="offset points",
                              ha="center", fontsize=9.5, color="0.35")  # fmt: skip
        axes.set_yticks(range(len(rows)), [segmentation_juhl.ROWS[name] for name in rows])
        axes.set_ylim(-0.6, len(rows) - 0.3)
        axes.grid(visible=True, axis="x")
        axes.set_xlabel("Dice in a band of 5³ voxels about the contour [%], a dot for each seed")
        axes.set_title("Simple shapes: regression of distances keeps the contour", x=-0.66)


def draw_atrium(logs: list[dict[str, Any]], target: Path) -> None:
    """How much each method differs from the baseline in Dice, with its 95 % confidence interval over the cases."""
    dice = values_of(logs, "dice")
    with drawing(target, protocol(logs), (12.0, 7.2)) as (_, axes):
        axes.set_position((0.21, 0.145, 0.76, 0.745))
        at, labels = 0, []
        for (family, names), hue in zip(FAMILIES.items(), HUES, strict=True):
            for number, name in enumerate(n for n in names if n in dice):
                values = [100 * v for v in differences(dice[name], dice["baseline"]).values()]
                label, half = family if number == 0 else None, half_width(values)
                axes.errorbar(statistics.fmean(values), -at, xerr=half, fmt="o", color=hue, capsize=3, label=label)
                axes.plot(values, [-at] * len(values), ".", color=hue, alpha=0.3, markersize=6)
                labels.append(name)
                at += 1
        axes.axvline(0, color="0.5", linewidth=1)
        axes.set_yticks([-i for i in range(len(labels))], labels)
        axes.grid(visible=True, axis="x")
        axes.set_xlabel("Dice less the baseline's [%]: mean, 95 % confidence interval, a dot for each case")
        axes.legend(loc="lower left")
        axes.set_title("Left atrium: what a distance map adds to a V-Net", x=-0.21)


if __name__ == "__main__":
    main()
