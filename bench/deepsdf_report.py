"""The tables and figures of some DeepSDF runs, in one page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bench._record import put, write

COLUMNS = {
    "chamfer": "Chamfer (points)",
    "chamfer_floor": "its floor",
    "chamfer_surface": "Chamfer (surface)",
    "mean_mm": "mean [mm]",
    "percentile95_mm": "95 % [mm]",
    "dice": "Dice",
}
PARTS = {
    "chamfer": "Chamfer (points)",
    "dice": "Dice",
    "seen_half_mean_mm": "seen half, mean [mm]",
    "other_half_mean_mm": "other half, mean [mm]",
    "other_half_95_mm": "other half, 95 % [mm]",
}
FIT = {key: key for key in ("seconds", "mean_mm", "percentile95_mm", "dice", "failed", "why")}


def report(runs: list[Path], to: Path) -> None:
    """Write `deepsdf.md`, `deepsdf.json` and, for a study of the recipe, `deepsdf_recipe.png` into a folder."""
    scores = {run.name: json.loads((run / "scores.json").read_text()) for run in runs if (run / "scores.json").exists()}
    lines = ["# DeepSDF", "", "Made by `python -m bench.deepsdf report`. Chamfer distances are times 1000."]
    for name, found in scores.items():
        lines += ["", f"## {name}", "", *_machines(found)]
        for title, part in _tables(found):
            lines += ["", f"### {title}", "", *part]
    put(to / "deepsdf.md", "\n".join(lines) + "\n")
    write(to / "deepsdf.json", scores)
    for found in scores.values():
        if "recipe_study" in found:
            _picture(found["recipe_study"], to / "deepsdf_recipe.png")
    print("\n".join(lines))


def _machines(found: dict[str, Any]) -> list[str]:
    """Where each part was measured."""
    machine, parts = found["machine"], {}
    for part, where in found.get("measured_on", {}).items():
        parts.setdefault(where, []).append(part)
    if not parts:
        return [f"On {machine['device']}, commit {machine['commit']}."]
    return [f"On {where}: {', '.join(names)}." for where, names in parts.items()]


def _tables(found: dict[str, Any]) -> list[tuple[str, list[str]]]:
    made = [(f"{n} shapes, {found[n]['shapes']}", _table(found[n], COLUMNS)) for n in ("known", "unseen") if n in found]
    made += [(f"completion, {n}", _table(found[n], PARTS)) for n in ("half", "noisy") if n in found]
    made += [(n, _pairs(found[n])) for n in ("training", "search", "speed", "maps") if n in found]
    made += [(f"fit by {way}", _rows(fit["rows"], FIT)) for way, fit in found.get("fits", {}).items() if "rows" in fit]
    study = found.get("recipe_study")
    if study is not None:
        made.append(("the approximate recipe", _pairs(study["recipe"])))
        ways = [(name, part) for name in ("exact", "approximate") for part in ("known", "unseen")]
        made += [(f"{name} samples, {part} shapes", _table(study[name][part], COLUMNS)) for name, part in ways]
    return made


def _table(part: dict[str, Any], columns: dict[str, str]) -> list[str]:
    rows = [{"": kind, **part[kind]} for kind in ("mean", "median") if kind in part]
    return _rows(rows, {"": "", **columns})


def _rows(rows: list[dict[str, Any]], columns: dict[str, str]) -> list[str]:
    head = "| " + " | ".join(columns.values()) + " |"
    body = ["| " + " | ".join(_text(row.get(key, "")) for key in columns) + " |" for row in rows]
    return [head, "|" + "---|" * len(columns), *body]


def _pairs(values: dict[str, Any]) -> list[str]:
    return ["| | |", "|---|---|", *(f"| {key} | {_text(value)} |" for key, value in values.items())]


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _picture(study: dict[str, Any], path: Path) -> None:
    """Chamfer distance of each shape, exact against approximate samples."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, part in zip(figure.subplots(1, 2), ("known", "unseen"), strict=True):
        for name, colour in (("exact", "#1f5a96"), ("approximate", "#c9453f")):
            rows = sorted(row["chamfer_surface"] for row in study[name][part]["rows"])
            axes.plot(range(1, len(rows) + 1), rows, marker="o", color=colour, label=f"{name} samples")
        axes.set(title=f"{part} shapes", xlabel="shapes, best first", ylabel="Chamfer distance to the surface x 1000")
        axes.set_yscale("log")
        axes.legend()
    figure.savefig(path, dpi=120)
