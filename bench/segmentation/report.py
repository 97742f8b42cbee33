"""Both studies of segmentation in one page, from their logs: tables, and which distance map helps, when, by how much.

    python -m sdm.bench.segmentation.report [--out bench/results/segmentation.md]

A method is compared with the baseline case by case, each case being the mean over the seeds that both have: mean
difference with its 95 % confidence interval (Student's t over the cases), and Wilcoxon's signed-rank test. With the 8
validation cases only differences that nearly all cases share can be told from chance. "Hard" is the half of the cases
in which the baseline has the lower Dice. The same follows without the case in whose 95HD the trainings differ most, and
seed by seed, with what chance does to a table like this. The same rows on whole volumes (`--whole`) follow, then
trainings by other protocols (`--trials`) in tables of their own, and ensembles, the mean over the seeds of a method.
Where some rows have more seeds than others, they are compared by those that all have.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.json_file import put
from sdm.bench.segmentation import juhl as segmentation_juhl
from sdm.bench.segmentation import juhl_atria
from sdm.bench.segmentation import ma as segmentation_ma
from sdm.bench.segmentation.ensemble_tables import ensembles_tables, mixtures_tables
from sdm.bench.segmentation.log_file import LogFile, log_file
from sdm.bench.segmentation.seeds import of_shared_seeds, repeats_table, seeds_table, shared_seeds
from sdm.bench.segmentation.trials import Logs, designs_and_others, effects_table, most_moved, trials_table
from sdm.segmentation import MA_ROWS, METHODS

OUT = "segmentation.md"
WHOLE = LogFile(results_folder() / "segmentation_ma_whole.jsonl")
TRIALS = LogFile(results_folder() / "segmentation_ma_trials.jsonl")
Values = dict[str, dict[str, float]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ma", type=log_file, default=segmentation_ma.LOGS)
    parser.add_argument("--juhl", type=log_file, default=segmentation_juhl.ONE_RATE)
    parser.add_argument("--juhl-rates", type=log_file, default=segmentation_juhl.LOGS)
    parser.add_argument("--juhl-atria", type=log_file, default=juhl_atria.LOGS)
    parser.add_argument("--whole", type=log_file, default=WHOLE)
    parser.add_argument("--trials", type=log_file, default=TRIALS)
    parser.add_argument("--out", type=Path, default=None, help=f"also written to this file, for instance {OUT}")
    options = parser.parse_args()
    text = page(options.ma, options.juhl, options.trials, options.whole, options.juhl_rates, options.juhl_atria)
    print(text)
    if options.out is not None:
        put(options.out, text + "\n")


def page(
    ma: LogFile,
    juhl: LogFile,
    trials: LogFile,
    whole: LogFile | None = None,
    rates: LogFile | None = None,
    atria: LogFile | None = None,
) -> str:
    """The page in Markdown."""
    logs, shape_logs = ma.trainings(), juhl.trainings()
    further = {} if whole is None else {whole.name: whole}
    found = {name: more for name, file in further.items() if (more := file.trainings())}
    parts = ["# Segmentation guided by distance maps", ""]
    parts += [
        "Made by `python -m sdm.bench.segmentation.report --out bench/results/segmentation.md`; logs beside it.",
        "",
    ]
    parts += ["## Left atrium (Ma et al.)", ""]
    if logs:
        parts += study(ma, logs)
        for name, more in found.items():
            title = f"### Whole volumes: a patch holds nearly all of one (logs in {name})"
            parts += [title, "", *study(further[name], more)]
        parts += other_protocols(logs, trials, found)
        parts += ensembles(ma, logs, further, trials)
    parts += ["## Simple shapes (Juhl et al.)", ""]
    if shape_logs:
        parts += [protocol(shape_logs), "", "Mean (sd) over test shapes and seeds; seeds in brackets:", ""]
        parts += [segmentation_juhl.table_of(juhl), ""]
        parts += ["Published: PWC 92.38, 68.49, 1.573, 1.947; PWR 97.08, 87.69, 0.714, 1.018.", ""]
    if rates is not None and (searched := rates.trainings()):
        parts += ["### Rates searched for each network, independent test shapes, cross-entropy alone too", ""]
        parts += [
            protocol(searched, rate="a rate of its own for each network"),
            "",
            segmentation_juhl.tables_of(rates),
            "",
        ]
    if atria is not None:
        parts += classification_and_regression(atria)
    return "\n".join(parts).rstrip()


def classification_and_regression(file: LogFile) -> list[str]:
    """Juhl's rows on left atria: the study, then its trials, each of one rate for each network."""
    parts = []
    titles = {"### Left atria in place of Juhl's medical data (largest component; logs in {})": file}
    titles |= {f"#### {name}, logs in {{}}": trial for name, trial in file.trials().items()}
    for title, own in titles.items():
        if logs := own.trainings():
            told = protocol(logs, rate="a rate of its own for each network")
            parts += [title.format(file.path.stem), "", told, "", juhl_atria.tables_of(own), ""]
    return parts


def study(file: LogFile, logs: Logs) -> list[str]:
    """Ma's rows by one protocol, whose logs are in a file: the tables, and each row beside the baseline."""
    same = of_shared_seeds(logs)
    told = "" if len(same) == len(logs) else f", by the {len(shared_seeds(logs))} seeds that all rows have"
    parts = [protocol(logs), "", "Largest connected component, mean (sd) over cases and seeds:", ""]
    parts += [segmentation_ma.table_of(file, "largest"), "", "As predicted, all components:", ""]
    parts += [segmentation_ma.table_of(file, "plain"), ""]
    parts += [f"Against the baseline, case by case (largest component){told}:", "", against_baseline(same), ""]
    return [*parts, *by_seed(same)]


def by_seed(logs: Logs) -> list[str]:
    """The comparison without the case that trainings differ most in, and seed by seed; nothing of one seed."""
    moved = most_moved(logs)
    found = seeds_table(logs, moved)
    if not found:
        return []
    parts = [f"The same without {moved[:4]}:", "", against_baseline(without(logs, moved)), ""]
    return [*parts, "Seed by seed, the mean over the cases (largest component):", "", found, ""]


def without(logs: Logs, case: str) -> Logs:
    """Logs that do not know a case."""
    parts = ("plain", "largest")
    return [{**log, **{p: {c: v for c, v in log[p].items() if c != case} for p in parts}} for log in logs]


def other_protocols(logs: Logs, trials: LogFile, further: Mapping[str, Logs]) -> list[str]:
    """Trainings that are not of the table; `further` is looked through for repetitions alone."""
    designs, others = designs_and_others(trials)
    if not others:
        return []
    parts = [f"### Other protocols (largest component; logs in {trials.name})", "", trials_table(logs, others), ""]
    if again := repeats_table({"the table": logs, **further, **others}, most_moved(logs)):
        parts += ["The same settings and the same seed twice (other commits, at times another machine):", "", again, ""]
    for name, design in designs.items():
        title = f"Effects of settings in the {len(design)} trainings of {name}, the mean of one half less the other's:"
        parts += [title, "", effects_table(design, most_moved([*logs, *design])), ""]
    for name, own in others.items():
        methods = {log["job"]["settings"]["method"] for log in own}
        seeds = shared_seeds(own)
        whole = len(seeds) > 1 or (len(seeds) == 1 and set(MA_ROWS) <= methods)
        if whole and "baseline" in methods and len(methods) > 1:
            count = f"means of {len(seeds)} seeds" if len(seeds) > 1 else "one seed"
            same = [log for log in own if log["job"]["settings"]["seed"] in seeds]
            parts += [f"Against the baseline, case by case, {count} of {name}:", "", against_baseline(same), ""]
    return parts


def ensembles(main: LogFile, logs: Logs, further: Mapping[str, LogFile], trials: LogFile) -> list[str]:
    """Those of the tables' trainings and of other protocols, then those over networks of several protocols."""
    others = trials.trials()
    table, moved = {"the table": main}, most_moved(logs)
    parts = {
        "### Ensembles: the mean of what networks say that differ in their seed (largest component)": (
            ensembles_tables({**table, **further, **others}, moved)
        ),
        # A training of other protocols may have been done again for a further table; its networks are not those mixed.
        "### Ensembles of several protocols, those of the first + those of the next (largest component)": (
            mixtures_tables({**table, **others}, logs, moved)
        ),
    }
    return [line for title, found in parts.items() if found for line in (title, "", found, "")]


def protocol(logs: Logs, rate: str = "") -> str:
    """Settings that all logs have in common, in a sentence."""
    settings = logs[0]["job"]["settings"]
    machines = sorted({log["machine"]["device"] for log in logs})
    seconds = statistics.median(log["training_s"] for log in logs)
    patch = "x".join(map(str, settings["patch"]))
    # Logs of before there was a choice have True.
    axes = logs[0]["job"].get("mirrors")
    mirrors = (
        f", mirrored along {'xyz' if axes is True else axes}, prediction the mean over mirror images" if axes else ""
    )
    told = ", told positions" if settings.get("position") else ""
    # So has what came with coarser voxels.
    coarse = f" of voxels {factor} times as large" if (factor := settings.get("coarsen", 1)) != 1 else ""
    return (
        f"{settings['architecture']}, patches {patch}{coarse}, batch {settings['batch']}, {settings['steps']} steps of "
        f"{settings['optimizer']} at {rate or format(settings['learning_rate'], 'g')}, "
        f"augmentation {settings['augment']}, maps of the {settings['targets']}{told}"
        f"{mirrors}; a training took {seconds:.0f} s (median; several may share a GPU) on "
        f"{', '.join(machines)}."
    )


def values_of(logs: Logs, column: str) -> dict[str, Values]:
    """Method -> seed -> case -> value; a failed case has the worst value of all that are finite."""
    found: dict[str, Values] = {}
    for log in logs:
        settings = log["job"]["settings"]
        cases = {name: float(scores[column]) for name, scores in log["largest"].items()}
        found.setdefault(settings["method"], {})[str(settings["seed"])] = cases
    finite = [v for m in found.values() for s in m.values() for v in s.values() if np.isfinite(v)]
    worst = max(finite, default=0.0)
    return {
        m: {s: {c: v if np.isfinite(v) else worst for c, v in cases.items()} for s, cases in seeds.items()}
        for m, seeds in found.items()
    }


def differences(method: Values, baseline: Values) -> dict[str, float]:
    """Case -> method minus baseline, the mean over the seeds that both have."""
    seeds = sorted(set(method) & set(baseline))
    cases = sorted(set.intersection(*(set(v[s]) for v in (method, baseline) for s in seeds))) if seeds else []
    return {c: statistics.fmean(method[s][c] - baseline[s][c] for s in seeds) for c in cases}


def against_baseline(logs: Logs) -> str:
    """A row for each method: the differences in Dice (percent) and 95HD (voxels)."""
    dice, distance = values_of(logs, "dice"), values_of(logs, "hausdorff95_mm")
    if "baseline" not in dice:
        return "The baseline is not there yet."
    hard = hard_cases(dice["baseline"])
    lines = ["| method | Dice | p | hard cases | others | 95HD | p |", "|---|---|---|---|---|---|---|"]
    for name in METHODS:
        if name == "baseline" or name not in dice:
            continue
        first = {c: 100 * v for c, v in differences(dice[name], dice["baseline"]).items()}
        second = differences(distance[name], distance["baseline"])
        if not first:
            continue
        halves = [[v for c, v in first.items() if (c in hard) == wanted] for wanted in (True, False)]
        means = [f"{statistics.fmean(half):+.2f}" if half else "-" for half in halves]
        cells = [interval(first), chance(first), *means, interval(second), chance(second)]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def hard_cases(baseline: Values) -> set[str]:
    cases = next(iter(baseline.values()))
    mean = {c: statistics.fmean(seed[c] for seed in baseline.values()) for c in cases}
    return set(sorted(mean, key=lambda c: mean[c])[: len(mean) // 2])


def interval(found: Mapping[str, float]) -> str:
    """Mean difference with its 95 % confidence interval."""
    values = list(found.values())
    mean = statistics.fmean(values)
    if len(values) < 2:
        return f"{mean:+.2f}"
    half = half_width(values)
    return f"{mean:+.2f} [{mean - half:+.2f}, {mean + half:+.2f}]"


def half_width(values: Sequence[float]) -> float:
    """Half of the 95 % confidence interval of a mean, by Student's t; two values or more."""
    return float(stats.t.ppf(0.975, len(values) - 1)) * statistics.stdev(values) / len(values) ** 0.5


def chance(found: Mapping[str, float]) -> str:
    """Wilcoxon's p."""
    values = [v for v in found.values() if v != 0]
    if len(values) < 2:
        return "-"
    _, p = stats.wilcoxon(values)
    return f"{p:.3f}"


if __name__ == "__main__":
    main()
