"""Effect of the seed on Ma's rows: each beside the baseline seed by seed, and how far a training repeats itself."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from sdm.bench.segmentation.trials import Logs, means, settings_of
from sdm.segmentation import METHODS

# Method -> seed -> means over the cases: Dice [%] and 95HD [voxels].
Rows = dict[str, dict[int, tuple[float, float]]]
# Trainings that are alike, each with the name of its logs.
Alike = Sequence[tuple[str, dict[str, Any]]]


@dataclass(frozen=True)
class Spread:
    """Spread by chance of a table of rows and seeds, in the values' unit.

    Attributes:
        deviation: Standard deviation of what is left of a value without its row's mean and its seed's.
        two: What the means of two rows that are alike differ by at most, 19 times of 20.
        furthest: What the one that is furthest from the first does, of all (Bonferroni).
    """

    deviation: float
    two: float
    furthest: float


def spread_of(values: np.ndarray) -> Spread:
    """Of (R,S) values, two rows and two seeds or more.

    A seed's share is taken out, as all rows have it: a seed decides which patches they are shown.
    """
    rows, seeds = values.shape
    rest = values - values.mean(1, keepdims=True) - values.mean(0, keepdims=True) + values.mean()
    free = (rows - 1) * (seeds - 1)
    deviation = float(np.sqrt((rest**2).sum() / free))
    error = deviation * (2 / seeds) ** 0.5
    limits = (float(stats.t.ppf(1 - 0.025 / count, free)) * error for count in (1, rows - 1))
    return Spread(deviation, *limits)


def _by_method_and_seed(logs: Logs) -> dict[str, dict[int, dict[str, Any]]]:
    found: dict[str, dict[int, dict[str, Any]]] = {}
    for log in logs:
        settings = log["job"]["settings"]
        found.setdefault(settings["method"], {})[settings["seed"]] = log
    return found


def shared_seeds(logs: Logs) -> list[int]:
    """Those that all methods have."""
    return sorted(set.intersection(*(set(seeds) for seeds in _by_method_and_seed(logs).values()))) if logs else []


def of_shared_seeds(logs: Logs) -> Logs:
    """The logs by which all methods can be compared: of the seeds that all have, or all logs if these are not two."""
    seeds = shared_seeds(logs)
    return [log for log in logs if log["job"]["settings"]["seed"] in seeds] if len(seeds) > 1 else logs


def rows_of(logs: Logs, without: str | None = None) -> Rows:
    """The rows that have every seed of the baseline, which comes first; none if it is not there."""
    found = _by_method_and_seed(logs)
    seeds = sorted(found.get("baseline", {}))
    names = [name for name in METHODS if seeds and set(seeds) <= set(found.get(name, {}))]
    return {name: {seed: means([found[name][seed]], without) for seed in seeds} for name in names}


def spreads(rows: Rows) -> tuple[Spread, Spread] | None:
    """Of Dice [%] and of 95HD [voxels]; None of less than two rows or seeds."""
    if len(rows) < 2 or len(rows["baseline"]) < 2:
        return None
    values = np.array([list(row.values()) for row in rows.values()])
    return spread_of(values[..., 0]), spread_of(values[..., 1])


def seeds_table(logs: Logs, case: str) -> str:
    """A row for each method, seed by seed, with all cases and without one, then what chance does.

    Empty of one seed or one row.
    """
    rows, rest = rows_of(logs), rows_of(logs, case)
    found, left = spreads(rows), spreads(rest)
    if found is None or left is None:
        return ""
    near = f"less the baseline's | without {case[:4]}"
    lines = [f"| method | Dice by seed | {near} | 95HD by seed | {near} |", "|---|---|---|---|---|---|---|"]
    for name in rows:
        cells = [cell for kind in (0, 1) for cell in _by_seed(rows, rest, name, kind)]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", _told(found, left, case[:4], len(rows), len(rows["baseline"]))])


def _by_seed(rows: Rows, rest: Rows, name: str, kind: int) -> tuple[str, str, str]:
    """A row's values, those less the baseline's, and the mean without a case; of Dice (0) or 95HD (1)."""
    values, usual = ([value[kind] for value in rows[n].values()] for n in (name, "baseline"))
    near, base = (statistics.fmean(value[kind] for value in rest[n].values()) for n in (name, "baseline"))
    told = ", ".join(f"{value:.1f}" for value in values)
    if name == "baseline":
        return told, "-", f"{near:.2f}"
    less = ", ".join(f"{value - other:+.1f}" for value, other in zip(values, usual, strict=True))
    return told, less, f"{near:.2f} ({near - base:+.2f})"


def _told(found: tuple[Spread, Spread], left: tuple[Spread, Spread], short: str, rows: int, seeds: int) -> str:
    """The spread by chance, in sentences."""

    def cell(key: str) -> str:
        (dice, distance), (rest, near) = ([getattr(one, key) for one in both] for both in (found, left))
        return f"{dice:.2f} % Dice and {distance:.2f} voxels ({rest:.2f} and {near:.2f} without {short})"

    return (
        f"What is left of a value without the mean of its row and that of its seed has a standard deviation of "
        f"{cell('deviation')}. Means over {seeds} seeds of two rows that are alike differ, 19 times of 20, by less "
        f"than {cell('two')}; the furthest of {rows - 1} from the baseline by less than {cell('furthest')}."
    )


def repeats(folders: Mapping[str, Logs]) -> list[list[tuple[str, dict[str, Any]]]]:
    """Trainings with the same settings, cases and seed, each with the name of its logs."""
    found: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for name, logs in folders.items():
        for log in logs:
            # Logs of before there was a choice have the twins among the training cases.
            same = [settings_of(log), log["job"].get("twins", "kept")]
            found.setdefault(json.dumps(same, sort_keys=True), []).append((name, log))
    return [same for same in found.values() if len(same) > 1]


def repeats_table(folders: Mapping[str, Logs], case: str) -> str:
    """A row for each training that was done twice, then what they differ by; empty if there is none."""
    found = repeats(folders)
    if not found:
        return ""
    lines = [f"| training | logs | Dice [%] | 95HD [voxels] | Dice, 95HD without {case[:4]} |", "|---|---|---|---|---|"]
    for same in found:
        all_, rest = ([means([log], without) for _, log in same] for without in (None, case))
        dice, distance = ([f"{value:.1f}" for value in column] for column in zip(*all_, strict=True))
        near = "; ".join(f"{one:.1f}, {other:.1f}" for one, other in rest)
        names = ", ".join(name for name, _ in same)
        lines.append(f"| {same[0][1]['job']['name']} | {names} | {', '.join(dice)} | {', '.join(distance)} | {near} |")
    lines += ["", _apart(found, case)]
    return "\n".join(lines)


def _apart(groups: Sequence[Alike], case: str) -> str:
    """Distance of a group's trainings from each other, of all and by the size of their voxels, in sentences."""

    def told(some: Sequence[Alike]) -> str:
        (dice, distance), (rest, near) = (
            deviations([[means([log], without) for _, log in group] for group in some]) for without in (None, case)
        )
        return f"{dice:.2f} % Dice and {distance:.2f} voxels ({rest:.2f} and {near:.2f} without {case[:4]})"

    by_size: dict[int, list[Alike]] = {}
    for group in groups:
        by_size.setdefault(settings_of(group[0][1])["coarsen"], []).append(group)
    parts = [f"Standard deviation of a training among those with its settings and seed: {told(groups)}"]
    if len(by_size) > 1:
        parts += [f"of voxels {n} times as large {told(some)}" for n, some in sorted(by_size.items()) if n > 1]
        parts += [f"of the images' own {told(by_size[1])}"] if 1 in by_size else []
    return "; ".join(parts) + "."


def deviations(groups: Sequence[Sequence[tuple[float, float]]]) -> tuple[float, float]:
    """Standard deviation within groups, of each of two values."""
    free = sum(len(group) - 1 for group in groups)
    rest = np.concatenate([np.array(group) - np.mean(group, axis=0) for group in groups])
    dice, distance = np.sqrt((rest**2).sum(0) / free)
    return float(dice), float(distance)
