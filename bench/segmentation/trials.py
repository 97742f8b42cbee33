"""Trainings of Ma's rows by other protocols than the table's: what differs, what came out, and in which cases."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from typing import Any

import numpy as np

from sdm.bench.segmentation.log_file import LogFile
from sdm.segmentation import Settings

Logs = list[dict[str, Any]]
# What a row of a table may differ in; anything else is the protocol.
OWN = ("method", "seed")
# Voxels that stand for the 95 % Hausdorff distance of an empty prediction: larger than any that was seen.
FAILED = 80.0
WORDS = {
    "patch": "patches {0[0]}x{0[1]}x{0[2]}",
    "coarsen": "voxels {} times as large",
    "batch": "batch {}",
    "steps": "{} steps",
    "learning_rate": "rate {:g}",
    "schedule": "{} rate",
    "average": "weights averaged over {:g}",
    "augment": "augmentation {}",
    "mirrors": "mirrored along {}",
    "last_dropout": "last dropout {:g}",
    "synthetic": "{:g} of the patches synthetic",
}


def settings_of(log: Mapping[str, Any]) -> dict[str, Any]:
    """Of a log, with the defaults of what was no choice then."""
    return Settings.of_record(log["job"]["settings"]).record()


def protocol_of(log: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in settings_of(log).items() if key not in OWN}


def differs(log: Mapping[str, Any], main: Mapping[str, Any]) -> str:
    """In what the protocol of a log is not that of the table."""
    own, usual = protocol_of(log), protocol_of(main)
    changed = {key: value for key, value in own.items() if value != usual[key]}
    told = [words(key, value) for key, value in changed.items()]
    if log["job"].get("twins") == "apart":
        told.append("near twins left out")
    return ", ".join(told) or "as in the table"


def words(key: str, value: Any) -> str:
    if key == "mirrors" and not value:
        return "not mirrored"
    if key == "position":
        return "told positions" if value else "not told positions"
    return WORDS.get(key, "{}").format(value)


def by_case(logs: Logs) -> dict[str, list[tuple[float, float]]]:
    """Case -> Dice [%] and 95HD [voxels] of the largest component, for each log."""
    found: dict[str, list[tuple[float, float]]] = {}
    for log in logs:
        for name, scores in log["largest"].items():
            distance = float(scores["hausdorff95_mm"])
            found.setdefault(name, []).append((100 * scores["dice"], distance if np.isfinite(distance) else FAILED))
    return found


def means(logs: Logs, without: str | None = None) -> tuple[float, float]:
    """Mean Dice and 95HD over logs and cases, all or all but one."""
    values = [v for name, case in by_case(logs).items() if name != without for v in case]
    return statistics.fmean(d for d, _ in values), statistics.fmean(h for _, h in values)


def most_moved(logs: Logs) -> str:
    """The case in whose 95HD the logs differ most."""
    return max(by_case(logs).items(), key=lambda item: statistics.pstdev(h for _, h in item[1]))[0]


def designs_and_others(file: LogFile) -> tuple[dict[str, Logs], dict[str, Logs]]:
    """By trial: logs of more than one protocol, from which effects are read, and those of one."""
    found = {name: logs for name, trial in file.trials().items() if (logs := trial.trainings())}
    mixed = {name for name, logs in found.items() if any(protocol_of(log) != protocol_of(logs[0]) for log in logs)}
    return {n: v for n, v in found.items() if n in mixed}, {n: v for n, v in found.items() if n not in mixed}


def trials_table(main: Logs, others: Mapping[str, Logs]) -> str:
    """A row for each protocol and method, then one for each protocol and case."""
    everything = [*main, *(log for logs in others.values() for log in logs)]
    moved = most_moved(everything)
    short = moved[:4]
    lines = [f"| logs | what differs | method | Dice [%] | 95HD [voxels] | by seed | Dice, 95HD without {short} |"]
    lines.append("|---|---|---|---|---|---|---|")
    for name, logs in others.items():
        methods = dict.fromkeys(log["job"]["settings"]["method"] for log in logs)
        for method in methods:
            own = [log for log in logs if log["job"]["settings"]["method"] == method]
            (dice, distance), (rest, near) = means(own), means(own, moved)
            seeds = "; ".join("{:.1f}, {:.1f}".format(*means([log])) for log in own)
            cells = [name, differs(own[0], main[0]), f"{method} ({len(own)})", f"{dice:.2f}", f"{distance:.2f}", seeds]
            lines.append(f"| {' | '.join(cells)} | {rest:.2f}, {near:.2f} |")
    cases = list(by_case(main))
    lines += ["", "95HD by case, mean over the trainings of a protocol:", ""]
    lines += [f"| logs (trainings) | {' | '.join(name[:4] for name in cases)} |", "|---|" + "---|" * len(cases)]
    for name, logs in {"the table": main, **others}.items():
        values = by_case(logs)
        cells = " | ".join(f"{statistics.fmean(h for _, h in values[case]):.1f}" for case in cases)
        lines.append(f"| {name} ({len(logs)}) | {cells} |")
    return "\n".join(lines)


def effects_table(logs: Logs, without: str) -> str:
    """Of a design: mean of the trainings with a setting less the mean of those without it."""
    settings = [settings_of(log) for log in logs]
    lines = [f"| instead of | | Dice [%] | 95HD [voxels] | Dice, 95HD without {without[:4]} |", "|---|---|---|---|---|"]
    for key in settings[0]:
        values = list(dict.fromkeys(s[key] for s in settings if not isinstance(s[key], list)))
        if key == "seed" or len(values) != 2:
            continue
        # The usual value first.
        values.sort(key=lambda value: value != getattr(Settings(), key))
        low, high = ([log for log, s in zip(logs, settings, strict=True) if s[key] == value] for value in values)
        cells = [np.subtract(means(high, x), means(low, x)) for x in (None, without)]
        rest = f"{cells[1][0]:+.2f}, {cells[1][1]:+.2f}"
        lines.append(f"| {words(key, values[0])} | {words(key, values[1])} | "
                     f"{cells[0][0]:+.2f} | {cells[0][1]:+.2f} | {rest} |")  # fmt: skip
    return "\n".join(lines)
