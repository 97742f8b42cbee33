"""Exact samples against the approximate recipe, from the figures of `bench.deepsdf recipe`: tables and a picture."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

from bench._deepsdf_tables import pairs, rows_table

KINDS = ("exact", "approximate")
COLOURS = {"exact": "#1f5a96", "approximate": "#c9453f"}
SCORES = {"chamfer_surface": "to the surface", "mean_mm": "mean [mm]", "percentile95_mm": "95 % [mm]", "dice": "Dice"}
QUALITY = {
    "seen_points": "points that the cameras see",
    "hidden": "share of the surface that none sees",
    "thrown_away": "share of samples thrown away",
    "wrong_signs": "share of wrong signs among the rest",
    "mean_error": "mean error [unit-sphere radii]",
    "percentile95_error": "95 % error [unit-sphere radii]",
    "worst_error": "worst error [unit-sphere radii]",
    "mean_error_mm": "mean error [mm]",
    "percentile95_error_mm": "95 % error [mm]",
    "seconds": "seconds of preparation a shape",
}


def is_study(found: dict[str, Any]) -> bool:
    """Whether a run's figures are those of a study."""
    return "recipe" in found


def trainings(found: dict[str, Any]) -> list[dict[str, Any]]:
    """The trainings that were finished."""
    return [part for name, part in found.items() if name.split(" ")[0] in KINDS]


def tables(found: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """Titles and tables: the samples, what was trained on them, and the difference that they make."""
    done = trainings(found)
    quality = {text: found["recipe"][name] for name, text in QUALITY.items()}
    made = [(f"the approximate samples, {found['shapes']} shapes", pairs(quality))]
    about = {
        "samples": "samples",
        "seed": "seed",
        "steps": "steps",
        "seconds": "training [s]",
        "before": "prepared [s]",
    }
    for part in ("known", "unseen"):
        rows = [
            {
                **{name: each[name] for name in ("samples", "seed")},
                **{name: each["training"][name] for name in ("steps", "seconds")},
                "before": found["recipe"]["seconds"] * found["shapes"] if each["samples"] == "approximate" else 0.0,
                **each[part]["mean"],
            }
            for each in done
        ]
        if rows:
            title = f"trained on them, {done[0][part]['shapes']} {part} shapes, means"
            made.append((title, rows_table(rows, about | SCORES)))
    differences = [row for part in ("known", "unseen") for row in _differences(done, part)]
    if differences:
        made.append(("differences, shape by shape", rows_table(differences, {"": "", **SCORES})))
    return made


def _differences(done: list[dict[str, Any]], part: str) -> list[dict[str, Any]]:
    """Means over shapes of what the recipe changes, and of what another seed does."""
    by = {(each["samples"], each["seed"]): each[part]["rows"] for each in done}
    pairs_of = {f"{part}: approximate less exact, seed {s}": (("approximate", s), ("exact", s)) for s in range(9)}
    pairs_of |= {f"{part}: {kind}, seed {s} less seed 0": ((kind, s), (kind, 0)) for kind in KINDS for s in range(1, 9)}
    rows = []
    for text, (one, other) in pairs_of.items():
        if one in by and other in by and len(by[one]) == len(by[other]):
            both = list(zip(by[one], by[other], strict=True))
            rows.append({"": text} | {name: statistics.fmean(a[name] - b[name] for a, b in both) for name in SCORES})
    return rows


def picture(studies: dict[str, dict[str, Any]], path: Path) -> None:
    """Mean distance of each shape's surface from the truth: exact samples' networks across, the recipe's upwards."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2 * len(studies)), layout="constrained")
    FigureCanvasAgg(figure)
    every = figure.subplots(len(studies), 2, squeeze=False)
    for (name, found), line in zip(studies.items(), every, strict=True):
        done = trainings(found)
        for axes, part in zip(line, ("known", "unseen"), strict=True):
            for each in done:
                rows = sorted(row["mean_mm"] for row in each[part]["rows"])
                style = "-" if each["seed"] == 0 else "--"
                label = f"{each['samples']} samples, seed {each['seed']}"
                axes.plot(range(1, len(rows) + 1), rows, style, marker="o", color=COLOURS[each["samples"]], label=label)
            error = found["recipe"]["mean_error_mm"]
            axes.axhline(error, color="#777777", linewidth=1, label="mean error of the approximate samples")
            axes.set(title=f"{name}, {part} shapes", xlabel="shapes, best first", ylabel="mean distance [mm]")
            axes.set_yscale("log")
        line[0].legend(fontsize="small")
    figure.savefig(path, dpi=120)
