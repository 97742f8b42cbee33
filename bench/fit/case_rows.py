"""Cases of a study as lines of JSON, small enough to be kept beside its record, and summaries of cases in two parts."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.json_file import put

DIGITS = 4


def write_rows(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """A line a case, numbers to four digits; atomic."""
    put(path, "".join(json.dumps(rounded(row), separators=(",", ":")) + "\n" for row in rows))


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Rows of a file, none where there is no file; a last line that was cut off does not count."""
    rows = []
    for text in path.read_text().splitlines() if path.is_file() else ():
        try:
            rows.append(json.loads(text))
        except json.JSONDecodeError:
            continue
    return rows


def commits(rows: Iterable[dict[str, Any]]) -> dict[str, int]:
    """Number of cases by commit."""
    return dict(Counter(row.get("commit", "unknown") for row in rows))


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """Floats of a record to so many significant digits."""
    if isinstance(value, dict):
        return {key: rounded(inner, digits) for key, inner in value.items()}
    if isinstance(value, list):
        return [rounded(inner, digits) for inner in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def merged(one: dict[str, Any], two: dict[str, Any]) -> dict[str, Any]:
    """The summary (`sdm.bench.fit.formation`) of the cases of two.

    Shares are counts of trusted fits and are added as such; means and deviations are those of both together, to the
    last digit that summaries keep. Medians cannot be put together: they are those of the second's cases.
    """
    if not (one["trusted"] and two["trusted"]):
        return {**(one if one["trusted"] else two), "cases": one["cases"] + two["cases"]}
    parts = [one, two]
    counts = [part["trusted"] for part in parts]
    total = sum(counts)
    before = [part.get("trusted_before", 0) for part in parts]
    names = list(one["coverage_90"])
    means = {key: [part["mean_of_z"][key] for part in parts] for key in names}
    mean = {key: _mean(means[key], counts) for key in names}
    square = {
        key: _mean([part["deviation_of_z"][key] ** 2 + part["mean_of_z"][key] ** 2 for part in parts], counts)
        for key in names
    }
    return {
        **two,
        "cases": one["cases"] + two["cases"],
        "trusted": total,
        "coverage_90": {key: _share([part["coverage_90"][key] for part in parts], counts) for key in names},
        "coverage_90_shape": _share([part["coverage_90_shape"] for part in parts], [4 * n for n in counts]),
        "coverage_90_all": _share([part["coverage_90_all"] for part in parts], [len(names) * n for n in counts]),
        "standard_error_of_one": round(math.sqrt(0.09 / total), 4),
        "mean_of_z": {key: round(mean[key], 3) for key in names},
        "deviation_of_z": {key: round(math.sqrt(square[key] - mean[key] ** 2), 3) for key in names},
        "largest_z": max(part["largest_z"] for part in parts),
        "not_trusted": one["not_trusted"] + two["not_trusted"],
        "coverage_90_shape_before": _share(
            [part.get("coverage_90_shape_before", 0.0) for part in parts], [4 * n for n in before]
        ),
        "trusted_before": sum(before),
        "standard_error_shape": round(_standard_error(parts, counts), 4),
        "medians_of": two["cases"],
    }


def _mean(values: Sequence[float], counts: Sequence[int]) -> float:
    return float(np.average(values, weights=counts))


def _share(shares: Sequence[float], counts: Sequence[int]) -> float:
    """Of all, from shares that were rounded: the counts behind them are whole numbers."""
    return round(sum(round(share * count) for share, count in zip(shares, counts, strict=True)) / sum(counts), 4)


def _standard_error(parts: Sequence[dict[str, Any]], counts: Sequence[int]) -> float:
    """Of the coverage of a shape's four parameters, from those of the parts, whose squares are variances / count."""
    total = sum(counts)
    means = [part["coverage_90_shape"] for part in parts]
    mean = _mean(means, counts)
    within = sum(
        part.get("standard_error_shape", 0.0) ** 2 * n * (n - 1) for part, n in zip(parts, counts, strict=True)
    )
    between = sum(n * (own - mean) ** 2 for own, n in zip(means, counts, strict=True))
    return math.sqrt((within + between) / (total - 1) / total)
