"""Exact samples against the approximate recipe, from `sdm.bench.deepsdf recipe`: tables and a picture."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

from sdm.bench.common.figure import sheet
from sdm.bench.deepsdf.tables import rows_table

KINDS = ("exact", "approximate")
COLOURS = {"exact": "#1f5a96", "approximate": "#c9453f"}
SCORES = {"chamfer_surface": "to the surface", "mean_mm": "mean [mm]", "percentile95_mm": "95 % [mm]", "dice": "Dice"}
QUALITY = {
    "seen_points": "points seen",
    "hidden": "surface hidden",
    "thrown_away": "thrown away",
    "wrong_signs": "wrong signs",
    "mean_error": "mean error [radii]",
    "percentile95_error": "95 % error [radii]",
    "worst_error": "worst error [radii]",
    "mean_error_mm": "mean error [mm]",
    "percentile95_error_mm": "95 % error [mm]",
    "seconds": "prepared, a shape [s]",
}


def is_study(found: dict[str, Any]) -> bool:
    """True if a run's figures are those of a study."""
    return "recipe" in found


def trainings(found: dict[str, Any]) -> list[dict[str, Any]]:
    """The trainings that were finished."""
    return [part for name, part in found.items() if name.split(" ")[0] in KINDS]


def qualities(studies: dict[str, dict[str, Any]]) -> list[str]:
    """A table of the approximate samples themselves, a line for each run."""
    columns = {"run": "run", "shapes": "shapes", "images": "images"} | QUALITY
    rows = [
        {
            "run": name,
            "shapes": found["shapes"],
            **found["recipe"],
            "images": "{views} of {pixels}^2".format(**found["recipe"]),
        }
        for name, found in studies.items()
    ]
    return rows_table(rows, columns)


def tables(found: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """Titles and tables: what was trained on either samples, and the difference that they make."""
    done, made = trainings(found), []
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
    """Mean distances of surfaces from the truth, shape by shape: exact samples across, other trainings upwards."""
    with sheet(path, (9, 4.4 * len(studies)), dpi=120, layout="constrained") as figure:
        every = figure.subplots(len(studies), 2, squeeze=False)
        for (name, found), line in zip(studies.items(), every, strict=True):
            for axes, part in zip(line, ("known", "unseen"), strict=True):
                first, *others = ([row["mean_mm"] for row in each[part]["rows"]] for each in trainings(found))
                for each, values in zip(trainings(found)[1:], others, strict=True):
                    label = f"{each['samples']} samples, seed {each['seed']}"
                    marker = "o" if each["seed"] == 0 else "s"
                    axes.scatter(first, values, marker=marker, alpha=0.8, color=COLOURS[each["samples"]], label=label)
                low, high = (end([*first, *(v for other in others for v in other)]) for end in (min, max))
                axes.plot([low, high], [low, high], color="#777777", linewidth=1, label="equal")
                axes.set(title=f"{name}, {part} shapes", xlabel="exact samples, seed 0: mean distance [mm]")
                axes.set(ylabel="another training: mean distance [mm]", aspect="equal")
            line[0].legend(fontsize="small")
