"""Means with intervals over cases and over seeds, for tables of studies."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass

# Share of intervals that hold the truth.
LEVEL = 0.95
# Seed -> case -> value.
Values = Mapping[int, Mapping[str, float]]


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Mean over cases and seeds.

    Args:
        mean: Over cases of the mean over seeds.
        median: Over cases of the mean over seeds.
        half_width: Of the 95 % interval of the mean by Student's t over cases; NaN with one case.
        seeds_sd: Standard deviation over seeds of the mean over cases; NaN with one seed.
        seeds: How many.
        cases: How many.
    """

    mean: float
    median: float
    half_width: float
    seeds_sd: float
    seeds: int
    cases: int

    def cell(self, digits: int = 3) -> str:
        """Mean +- interval over cases (sd over seeds)."""
        spread = f" ({self.seeds_sd:.{digits}f})" if self.seeds > 1 else ""
        width = f" ± {self.half_width:.{digits}f}" if self.cases > 1 else ""
        return f"{self.mean:.{digits}f}{width}{spread}"


def estimate(values: Values) -> Estimate:
    """The estimate of some measure.

    Args:
        values: Seed -> case -> value; every seed has the same cases.

    Raises:
        ValueError: No values, or seeds that have other cases.
    """
    cases = sorted(next(iter(values.values()), {}))
    if not cases or any(sorted(own) != cases for own in values.values()):
        raise ValueError("an estimate needs the same cases, at least one, of every seed")
    by_case = [statistics.fmean(own[case] for own in values.values()) for case in cases]
    by_seed = [statistics.fmean(own.values()) for own in values.values()]
    return Estimate(
        mean=statistics.fmean(by_case),
        median=statistics.median(by_case),
        half_width=_half_width(by_case),
        seeds_sd=statistics.stdev(by_seed) if len(by_seed) > 1 else float("nan"),
        seeds=len(by_seed),
        cases=len(cases),
    )


def difference(values: Values, other: Values) -> Estimate:
    """The estimate of `values` less `other`, case by case and, where both have a seed, seed by seed.

    Where they share no seed (a baseline has none), each side's mean over seeds is compared.
    """
    shared = sorted(set(values) & set(other))
    if len(shared) > 1:
        return estimate({s: {c: v - other[s][c] for c, v in values[s].items()} for s in shared})
    left, right = _over_seeds(values), _over_seeds(other)
    return estimate({0: {case: left[case] - right[case] for case in left}})


def _over_seeds(values: Values) -> dict[str, float]:
    first = next(iter(values.values()))
    return {case: statistics.fmean(own[case] for own in values.values()) for case in first}


def _half_width(values: list[float]) -> float:
    from scipy import stats

    if len(values) < 2:
        return float("nan")
    return float(stats.t.ppf((1 + LEVEL) / 2, len(values) - 1)) * statistics.stdev(values) / len(values) ** 0.5
