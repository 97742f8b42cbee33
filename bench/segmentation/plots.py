"""Pictures of both studies of segmentation, from their logs: `python -m sdm.bench.segmentation.plots [--out docs]`."""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path
from typing import TYPE_CHECKING

from sdm.bench.common.checkout import docs_folder
from sdm.bench.common.figure import COLOURS, OURS, drawing
from sdm.bench.segmentation import juhl, ma
from sdm.bench.segmentation.log_file import log_file
from sdm.bench.segmentation.report import WHOLE, differences, half_width, protocol, values_of
from sdm.bench.segmentation.seeds import of_shared_seeds, rows_of, spreads
from sdm.bench.segmentation.trials import Logs, most_moved
from sdm.segmentation import METHODS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    parser.add_argument("--ma", type=log_file, default=ma.LOGS)
    parser.add_argument("--juhl", type=log_file, default=juhl.ONE_RATE)
    parser.add_argument("--whole", type=log_file, default=WHOLE)
    parser.add_argument("--out", type=Path, default=docs_folder())
    options = parser.parse_args()
    if logs := options.juhl.trainings():
        draw_shapes(logs, options.out / "segmentation-shapes.png")
    if logs := options.ma.trainings():
        draw_atrium(logs, options.out / "segmentation-atrium.png", "Left atrium, patches: each row beside the baseline")
    if logs := options.whole.trainings():
        title = "Left atrium, whole volumes: each row beside the baseline"
        draw_atrium(logs, options.out / "segmentation-atrium-whole.png", title)


def draw_shapes(logs: Logs, target: Path) -> None:
    """Contour Dice of every row, one dot for each seed, and what was published."""
    found: dict[str, list[float]] = {}
    for log in logs:
        for way in ("nearest", "linear"):
            name = f"{log['job']['network']} {way}"
            found.setdefault(name, []).append(100 * statistics.fmean(row["contour_dice"] for row in log[way]))
    rows = [name for name in juhl.ROWS if name in found][::-1]
    with drawing(target, protocol(logs), (12.0, 5.2)) as (_, axes):
        axes.set_position((0.40, 0.20, 0.57, 0.66))
        axes.margins(x=0.08)
        for at, name in enumerate(rows):
            hue = COLOURS[OURS] if name.startswith("pwr") else COLOURS["Warp winding number"]
            axes.plot(found[name], [at] * len(found[name]), "o", color=hue, alpha=0.45)
            axes.plot(statistics.fmean(found[name]), at, "|", color=hue, markersize=26, markeredgewidth=3)
            if name in PUBLISHED:
                axes.plot(PUBLISHED[name], at, "D", color="0.25", markersize=7, fillstyle="none")
                axes.annotate("published", (PUBLISHED[name], at), xytext=(0, 16), textcoords="offset points",
                              ha="center", fontsize=9.5, color="0.35")  # fmt: skip
        axes.set_yticks(range(len(rows)), [juhl.ROWS[name] for name in rows])
        axes.set_ylim(-0.6, len(rows) - 0.2)
        axes.grid(visible=True, axis="x")
        axes.set_xlabel("Dice in a band of 5³ voxels about the contour [%], a dot for each seed")
        axes.set_title("Simple shapes: regression of distances keeps the contour", x=-0.66)


def draw_atrium(logs: Logs, target: Path, title: str) -> None:
    """Each row's Dice less the baseline's, case by case, and its 95HD with and without one case.

    By the seeds that all rows have.
    """
    logs = of_shared_seeds(logs)
    dice, moved = values_of(logs, "dice"), most_moved(logs)
    rows, rest = rows_of(logs), rows_of(logs, moved)
    hues = {name: hue for names, hue in zip(FAMILIES.values(), HUES, strict=True) for name in names}
    names = ["baseline", *(name for name in hues if name in rows)]
    caption = (
        f"{protocol(logs)} {len(rows['baseline'])} seeds. Chance: means over them of two rows that are alike "
        "differ by less, 19 times of 20."
    )
    with drawing(target, caption, (12.0, 7.2)) as (figure, axes):
        axes.set_position((0.17, 0.145, 0.45, 0.70))
        if (found := spreads(rows)) is not None:
            axes.axvspan(-found[0].two, found[0].two, color="0.92", label="chance")
        axes.axvline(0, color="0.5", linewidth=1)
        for at, name in enumerate(names[1:], 1):
            case_by_case = {c: 100 * v for c, v in differences(dice[name], dice["baseline"]).items()}
            values = list(case_by_case.values())
            mean, half = statistics.fmean(values), half_width(values)
            axes.errorbar(mean, -at, xerr=half, fmt="o", color=hues[name], capsize=3)
            others = [value for case, value in case_by_case.items() if case != moved]
            axes.plot(others, [-at] * len(others), ".", color=hues[name], alpha=0.35, markersize=6)
            axes.plot(
                case_by_case[moved], -at, "D", color=hues[name], markersize=5, fillstyle="none", markeredgewidth=1.2
            )
        axes.set_yticks([-at for at in range(len(names))], names)
        axes.set_xlabel("Dice less the baseline's [%]")
        far = figure.add_axes((0.655, 0.145, 0.325, 0.70), sharey=axes)
        for at, name in enumerate(names):
            hue = hues.get(name, "black")
            for values, style, fill in ((rows[name], "o", "full"), (rest[name], "D", "none")):
                seeds = [distance for _, distance in values.values()]
                far.plot(seeds, [-at] * len(seeds), "o", color=hue, alpha=0.45, markersize=3.2, fillstyle=fill)
                far.plot(statistics.fmean(seeds), -at, style, color=hue, fillstyle=fill)
        far.tick_params(labelleft=False)
        far.set_xlabel("95 % Hausdorff distance [voxels]")
        for one in (axes, far):
            one.grid(visible=True, axis="x")
            one.locator_params(axis="x", integer=True, nbins=8)
            one.set_ylim(-len(names) + 0.4, 1.3)
        _explain(axes, far, moved[:4])
        axes.set_title(title, x=-0.35, pad=44)


def _explain(axes: Axes, far: Axes, moved: str) -> None:
    """Legend of dots and diamonds, above the axes."""
    for one, lines in (
        (axes, (("o", "mean, 95 % interval"), (".", "a case"), ("D", f"case {moved}"))),
        (far, (("o", "all cases"), ("D", f"without {moved}"), (".", "a seed"))),
    ):
        for marker, label in lines:
            colour, fill = ("0.6" if marker == "." else "0.25"), ("none" if marker == "D" else "full")
            one.plot([], [], marker=marker, label=label, color=colour, fillstyle=fill, linestyle="")
        one.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=4, columnspacing=1.0, handletextpad=0.2,
                   handlelength=1.4, fontsize=10)  # fmt: skip


if __name__ == "__main__":
    main()
