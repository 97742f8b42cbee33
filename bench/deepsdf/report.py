"""The tables and figures of some DeepSDF runs, in one page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import put, write
from sdm.bench.deepsdf import fit_picture
from sdm.bench.deepsdf import recipe_study as study
from sdm.bench.deepsdf.tables import pairs, rows_table

COLUMNS = {
    "chamfer": "Chamfer, unit sphere",
    "chamfer_floor": "its floor",
    "chamfer_paper": "Chamfer, paper's scale",
    "chamfer_paper_floor": "its floor",
    "chamfer_surface": "to the surface",
    "emd": "EMD",
    "accuracy": "accuracy",
    "completion": "completion",
    "normal_cosine": "cosine",
    "mean_mm": "mean [mm]",
    "percentile95_mm": "95 % [mm]",
    "dice": "Dice",
}
PARTS = {
    "chamfer": "Chamfer, unit sphere",
    "emd": "EMD",
    "accuracy": "accuracy",
    "completion": "completion",
    "normal_cosine": "cosine",
    "dice": "Dice",
    "seen_half_mean_mm": "seen half, mean [mm]",
    "other_half_mean_mm": "other half, mean [mm]",
    "other_half_95_mm": "other half, 95 % [mm]",
}
FIT = {key: key for key in ("seconds", "mean_mm", "percentile95_mm", "dice", "failed", "why")}
ABOUT = """\
Made by `python -m sdm.bench.deepsdf report`. Chamfer distances are 1000 times the sum of both mean squared
distances between 30,000 points of each surface; a floor is what a perfect answer scores. Paper's scale: the true
surface's bounding box has a diagonal of 1 (why: `sdm/deepsdf/infer/scores.py`). To the surface: exactly, not to points
of it, in unit-sphere radii."""

QUALITY = """\
Against exact values within 0.1 unit-sphere radii of the surface; means over the shapes, the worst error of all. Thrown
away: the share of the samples without a clear vote. Wrong signs: the share of those that are left. Surface hidden: the
share of it that is 0.01 radii or further from every point seen. Prepared: what cameras, tree and neighbours take."""


def report(runs: list[Path], to: Path) -> None:
    """Write `deepsdf.md`, `deepsdf.json`, and pictures of the recipe's and the fits' studies into a folder."""
    scores = {run.name: json.loads((run / "scores.json").read_text()) for run in runs if (run / "scores.json").exists()}
    lines = ["# DeepSDF", "", *ABOUT.splitlines()]
    for name, found in scores.items():
        lines += ["", f"## {name}", "", *_machines(found)]
        for title, part in _tables(found):
            lines += ["", f"### {title}", "", *part]
    studies = {name: found for name, found in scores.items() if study.is_study(found)}
    if studies:
        lines += ["", "## The approximate recipe's samples", "", *QUALITY.splitlines(), "", *study.qualities(studies)]
    put(to / "deepsdf.md", "\n".join(lines) + "\n")
    write(to / "deepsdf.json", scores)
    compared = {name: found for name, found in studies.items() if len(study.trainings(found)) > 1}
    if compared:
        study.picture(compared, to / "deepsdf_recipe.png")
    fitted = {name: found for name, found in scores.items() if fit_picture.is_fit(found)}
    if fitted:
        fit_picture.picture(fitted, to / "deepsdf_fit.png")
    print("\n".join(lines))


def _machines(found: dict[str, Any]) -> list[str]:
    """The machine and commit of each part."""
    machine, parts = found["machine"], {}
    for part, where in found.get("measured_on", {}).items():
        parts.setdefault(where, []).append(part)
    if not parts:
        return [f"On {machine['device']}, commit {machine['commit']}."]
    return [f"On {where}: {', '.join(names)}." for where, names in parts.items()]


def _tables(found: dict[str, Any]) -> list[tuple[str, list[str]]]:
    if study.is_study(found):
        return study.tables(found)
    made = [(f"{n} shapes, {found[n]['shapes']}", _table(found[n], COLUMNS)) for n in ("known", "unseen") if n in found]
    made += [(f"completion, {n}", _table(found[n], PARTS)) for n in ("half", "noisy") if n in found]
    made += [(n, pairs(found[n])) for n in ("training", "search", "speed", "maps") if n in found]
    made += [
        (f"fit by {way}", rows_table(fit["rows"], FIT)) for way, fit in found.get("fits", {}).items() if "rows" in fit
    ]
    return made


def _table(part: dict[str, Any], columns: dict[str, str]) -> list[str]:
    rows = [{"": kind, **part[kind]} for kind in ("mean", "median") if kind in part]
    return rows_table(rows, {"": "", **columns})
