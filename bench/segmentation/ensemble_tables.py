"""Scores of ensembles of Ma's rows, beside the trainings of their networks; of one protocol, and of several."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from sdm.bench.segmentation.ensembles import seeds_of
from sdm.bench.segmentation.log_file import LogFile, groups_of, is_mixed
from sdm.bench.segmentation.trials import Logs, by_case, differs, means, settings_of
from sdm.segmentation import METHODS

# Name of its logs, its own log, and those of its networks' trainings.
Found = tuple[str, dict[str, Any], Logs]


def ensembles_tables(files: Mapping[str, LogFile], moved: str | None = None) -> str:
    """A row for each ensemble of one protocol beside the mean over its seeds' trainings, then its cases.

    Empty if there are none. An empty prediction counts as a distance of `FAILED`. A mean is missing where the log of
    one of its trainings is. If there is a case `moved`, the means without it follow.
    """
    found = [
        (name, log, _trainings(log, file))
        for name, file in files.items()
        for log in _ordered(file)
        if not is_mixed(log)
    ]
    return _tables(found, moved)


def mixtures_tables(files: Mapping[str, LogFile], main: Logs, moved: str | None = None) -> str:
    """The protocols that ensembles mix, less those of `main`; then as `ensembles_tables`, of these ensembles.

    The log of a training may be in any of the files: it is known by its settings and seed. Of one that was done
    more than once it is the first.
    """
    logs = [(name, log) for name, file in files.items() for log in _ordered(file) if is_mixed(log)]
    if not logs:
        return ""
    known: dict[str, dict[str, Any]] = {}
    for file in files.values():
        for one in file.trainings():
            known.setdefault(_key(settings_of(one)), one)
    told = dict.fromkeys(f"- {name}: {_protocols(log, main)}" for name, log in logs)
    return "\n".join([*told, "", _tables([(name, log, _of_networks(log, known)) for name, log in logs], moved)])


def _protocols(log: Mapping[str, Any], main: Logs) -> str:
    """Of the networks that a log's ensemble mixes, each with what differs from the table's."""
    groups = [{"job": group} for group in groups_of(log["job"])]
    if not main:
        return " + ".join(["networks of one protocol", *(differs(group, groups[0]) for group in groups[1:])])
    return " + ".join(differs(group, main[0]) for group in groups)


def _of_networks(log: Mapping[str, Any], known: Mapping[str, dict[str, Any]]) -> Logs:
    """The trainings with the settings and seeds of an ensemble's networks; none unless all are known."""
    wanted = [
        _key(settings_of({"job": {"settings": {**group["settings"], "seed": seed}}}))
        for group in groups_of(log["job"])
        for seed in group["seeds"]
    ]
    return [known[key] for key in wanted] if set(wanted) <= set(known) else []


def _key(settings: Mapping[str, Any]) -> str:
    return repr(sorted(settings.items()))


def _tables(found: Sequence[Found], moved: str | None) -> str:
    """Means, then 95HD by case."""
    lines = ["| logs | method (seeds) | Dice [%] | mean of seeds | 95HD [voxels] | mean of seeds |"]
    lines.append("|---|---|---|---|---|---|")
    if moved is not None:
        lines = [lines[0] + f" Dice, 95HD without {moved[:4]} | mean of seeds |", lines[1] + "---|---|"]
    for name, log, own in found:
        both = zip(means([log]), means(own) if own else (None, None), strict=True)
        cells = [text for pair in both for text in ("-" if value is None else f"{value:.2f}" for value in pair)]
        if moved is not None:
            cells += ["{:.2f}, {:.2f}".format(*means(logs, moved)) if logs else "-" for logs in ([log], own)]
        lines.append(f"| {name} | {_called(log)} | {' | '.join(cells)} |")
    if not found:
        return ""
    cases = list(by_case([found[0][1]]))
    lines += ["", "95HD of an ensemble by case, in brackets the mean of its seeds:", ""]
    lines += [
        f"| logs | method (seeds) | {' | '.join(case[:4] for case in cases)} |",
        "|---|---|" + "---|" * len(cases),
    ]
    for name, log, own in found:
        one, several = by_case([log]), by_case(own)
        cells = [_distances(one.get(case, [])) + f" ({_distances(several.get(case, []))})" for case in cases]
        lines.append(f"| {name} | {_called(log)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _ordered(file: LogFile) -> Logs:
    order = list(METHODS)
    return sorted(file.ensembles(), key=lambda log: order.index(log["job"]["settings"]["method"]))


def _trainings(log: Mapping[str, Any], file: LogFile) -> Logs:
    """Those of an ensemble's seeds; none unless all are there."""
    method, seeds = log["job"]["settings"]["method"], log["job"]["seeds"]
    names = {f"{method}-{seed}" for seed in seeds}
    own = [one for one in file.trainings() if one["job"]["name"] in names]
    return own if len(own) == len(seeds) else []


def _called(log: Mapping[str, Any]) -> str:
    return f"{log['job']['settings']['method']} ({seeds_of(log['job'])})"


def _distances(values: Sequence[tuple[float, float]]) -> str:
    return f"{statistics.fmean(distance for _, distance in values):.1f}" if values else "-"
