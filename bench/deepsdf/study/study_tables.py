"""Tables and the picture of the DeepSDF study, from its logs."""

from __future__ import annotations

import math
import statistics
from pathlib import Path
from typing import Any

from sdm.bench.common.figure import COLOURS, OURS, drawing, log_axes, plain_ticks
from sdm.bench.deepsdf.study.atria_split import read_record, table_of
from sdm.bench.deepsdf.tables import rows_table
from sdm.bench.segmentation.log_file import Log, LogFile
from sdm.bench.studies.intervals import Estimate, Values, difference, estimate

NAMES = {
    "published": "published network, 256 numbers",
    "local-256": "local codes, 256 numbers",
    "local": "local codes, 14,912 numbers",
    "copy": "copy of the nearest training shape",
    "copy-laid": "the same, laid on what is known",
    "map-6": "exact map of 6^3 = 216 numbers, cubic",
    "map-24": "exact map of 24^3 = 13,824 numbers, cubic",
}
# What every method is compared with, shape by shape.
COPIES = {"copy": "the copy", "copy-laid": "the copy that is laid on"}
# Measure -> its heading, and digits.
MEASURES = {
    "chamfer_paper": ("Chamfer", 3),
    "emd": ("EMD", 4),
    "accuracy": ("accuracy", 4),
    "completion": ("completion", 3),
    "normal_cosine": ("cosine", 3),
    "mean_mm": ("mean [mm]", 3),
    "dice": ("Dice", 4),
}
HALVES = {"seen_mm": ("seen half [mm]", 2), "other_mm": ("other half [mm]", 2)}
TITLES = {
    "unseen": "Test shapes, all of the surface known",
    "half": "Completion: half of the surface known",
    "known": "Shapes of the training, by its codes",
    "validation": "Validation shapes, by the first seed at each method's best rate: chosen on, so no result",
}
ABOUT = """\
Mean over shapes of the mean over seeds, ± half of its 95 % interval (Student's t over shapes), in brackets the standard
deviation over seeds. Chamfer is the mean, then the median; 1000 times the sum of both mean squared distances of 30,000
points. Chamfer, EMD (500 points), accuracy (90 %) and completion (within 0.01) are in the paper's scale: the box's
diagonal is 1."""


def page(logs: LogFile) -> str:
    """The page in Markdown: the protocol, the split, and all tables."""
    found = logs.trainings()
    machines = sorted({f"{log['machine']['device']}, commit {log['machine']['commit']}" for log in found})
    training = next((log for log in found if "training" in log), None)
    lines = ["# DeepSDF on left atria: equal code sizes, rates searched, baselines", ""]
    made = "Made by `python -m sdm.bench.deepsdf.study table --page bench/results/deepsdf_study.md`."
    lines += [f"{made} On {'; '.join(machines)}."]
    if training is not None:
        own, job = training["training"]["settings"], training["job"]
        lines += [
            f"Each training: {job['steps']} steps of {own['shapes']} shapes and {own['points']} samples each.",
            f"Codes of test shapes: {job['search_steps']} steps. Several trainings shared a GPU.",
        ]
    lines += ["", "## Near twins and the split", "", table_of(read_record()), "", "## Results", ""]
    return "\n".join([*lines, tables(logs), ""])


def tables(logs: LogFile) -> str:
    """All tables of the study, in Markdown."""
    found = logs.trainings()
    if not found:
        return "There are no logs yet."
    parts = [
        "Rates: mean distance from the validation shapes in mm, by the first seed.",
        "",
        rates_table(found),
        "",
        ABOUT,
    ]
    for task, title in TITLES.items():
        values = values_of(found, task)
        if values:
            parts += ["", f"**{title}**", "", *task_table(values, task)]
    return "\n".join(parts)


def rates_table(logs: list[Log]) -> str:
    """A row for each method, a column for each rate; the lowest in bold."""
    own: dict[str, dict[float, float]] = {}
    for log in logs:
        if log["job"]["kind"] == "rate":
            own.setdefault(log["job"]["method"], {})[log["job"]["rate"]] = log["validation_mm"]
    rates = sorted({rate for row in own.values() for rate in row})
    lines = ["| |" + "".join(f" {rate:g} |" for rate in rates), "|---|" + "---|" * len(rates)]
    for name in (n for n in NAMES if n in own):
        best = min(own[name].values())
        cells = [f"{own[name][r]:.3f}" if r in own[name] else "-" for r in rates]
        # The best of one is no choice.
        cells = [f"**{c}**" if c == f"{best:.3f}" and len(own[name]) > 1 else c for c in cells]
        lines.append(f"| {NAMES[name]} | {' | '.join(cells)} |")
    return "\n".join(lines)


def values_of(logs: list[Log], task: str) -> dict[str, dict[int, dict[str, dict[str, float]]]]:
    """Row -> seed -> shape -> scores, in the table's order; for validation by each method's best rate."""
    found: dict[str, dict[int, dict[str, dict[str, float]]]] = {}
    for log in sorted(logs, key=lambda log: -log.get("validation_mm", 0.0)) if task == "validation" else logs:
        if task == "validation" and log["job"]["kind"] == "rate":
            # The best rate comes last, and stays.
            found[log["job"]["method"]] = {log["job"]["seed"]: log[task]}
        elif task != "validation" and log["job"]["kind"] == "test":
            found.setdefault(log["job"]["method"], {})[log["job"]["seed"]] = log[task]
        elif log["job"]["kind"] == "baselines":
            found |= {name: {0: rows} for name, rows in log.get(task, {}).items()}
    return {name: found[name] for name in NAMES if name in found}


def of_measure(row: dict[int, dict[str, dict[str, float]]], measure: str) -> Values:
    """Seed -> shape -> one score."""
    return {seed: {case: scores[measure] for case, scores in cases.items()} for seed, cases in row.items()}


def task_table(values: dict[str, dict[int, dict[str, dict[str, float]]]], task: str) -> list[str]:
    """A row for each method and baseline; then what each method gains over either copy, shape by shape."""
    measures = MEASURES | (HALVES if task == "half" else {})
    rows = [{"": f"{NAMES[name]} ({len(row)})", **_cells(row, measures)} for name, row in values.items()]
    first = next(iter(next(iter(values.values())).values()))
    floor = {key: [case[f"{key}_floor"] for case in first.values()] for key in ("chamfer_paper", "emd")}
    means = {key: f"{statistics.fmean(own):.{MEASURES[key][1]}f}" for key, own in floor.items()}
    means["chamfer_paper"] += f"; {statistics.median(floor['chamfer_paper']):.3f}"
    perfect = {"accuracy": "0", "completion": "1", "normal_cosine": "1", "mean_mm": "0", "dice": "1"}
    rows.append({"": "a perfect answer", **perfect, **means, **dict.fromkeys(HALVES, "0")})
    lines = rows_table(rows, {"": "(seeds)", **{key: head for key, (head, _) in measures.items()}})
    if "copy-laid" not in values:
        return lines
    over = "other_mm" if task == "half" else "mean_mm"
    lines += [""]
    for name in (n for n in values if n not in COPIES):
        less = [
            f"{_signed(difference(of_measure(values[name], over), of_measure(values[copy], over)))} against {told}"
            for copy, told in COPIES.items()
            if copy in values
        ]
        lines.append(f"- {NAMES[name]}, {measures[over][0]}: {', '.join(less)}")
    return lines


def _signed(less: Estimate) -> str:
    return f"{less.mean:+.3f} ± {less.half_width:.3f}"


def _cells(row: dict[int, dict[str, dict[str, float]]], measures: dict[str, tuple[str, int]]) -> dict[str, str]:
    cells = {}
    for key, (_, digits) in measures.items():
        found = estimate(of_measure(row, key))
        cells[key] = found.cell(digits) if math.isfinite(found.mean) else "some without a surface"
        if key == "chamfer_paper":
            cells[key] += f"; {found.median:.{digits}f}"
    return cells


def picture(logs: LogFile, target: Path) -> None:
    """Mean distance of every test shape by every method, and the baselines; both tasks."""
    from matplotlib.ticker import LogLocator

    found = logs.trainings()
    about = sorted({str(log["machine"]["device"]) for log in found})
    with drawing(target, "; ".join(about), (12.5, 5.6)) as (figure, axes):
        axes.remove()
        tasks = (
            ("unseen", "mean_mm", "All of the surface known"),
            ("half", "other_mm", "Completion: the half not seen"),
        )
        for place, (task, measure, title) in enumerate(tasks):
            own: Any = figure.add_axes((0.32 + 0.345 * place, 0.17, 0.315, 0.68))
            values = values_of(found, task)
            names = [n for n in NAMES if n in values_of(found, "unseen")][::-1]
            for at, name in enumerate(names):
                if name not in values:
                    continue
                hue = COLOURS[OURS] if name.startswith("local") else "#1f5a96" if name == "published" else "#777777"
                cases = estimate_cases(of_measure(values[name], measure))
                own.plot(cases, [at] * len(cases), "o", color=hue, alpha=0.4)
                own.plot(statistics.fmean(cases), at, "|", color=hue, markersize=24, markeredgewidth=3)
            log_axes(own, y=False)
            # The right one is less than a decade.
            own.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if place == 0 else (1, 1.5, 2, 3, 5)))
            plain_ticks(own.xaxis, "{:g}")
            own.set_yticks(range(len(names)), [NAMES[n] for n in names] if place == 0 else [""] * len(names))
            own.set_ylim(-0.6, len(names) - 0.4)
            own.grid(visible=True, axis="x")
            own.set_title(title, fontsize=13)
            own.set_xlabel("mean distance [mm]")
        figure.text(0.01, 0.93, "Left atria: a dot for each test shape, near twins apart", fontsize=16, weight="bold")


def estimate_cases(values: Values) -> list[float]:
    """Mean over seeds of each case."""
    first = next(iter(values.values()))
    return [statistics.fmean(own[case] for own in values.values()) for case in first]
