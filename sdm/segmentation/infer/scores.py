"""Scores of many cases: the mean and standard deviation of a table's cell."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from torch import Tensor

from sdm.metrics import SegmentationScores, evaluate_segmentation

# Field of the scores -> head of its column, factor, unit.
COLUMNS = {
    "dice": ("Dice", 100.0, "%"),
    "jaccard": ("Jaccard", 100.0, "%"),
    "contour_dice": ("contour Dice", 100.0, "%"),
    "hausdorff95_mm": ("95HD", 1.0, "mm"),
    "average_surface_distance_mm": ("ASD", 1.0, "mm"),
    "rms_surface_distance_mm": ("RMSD", 1.0, "mm"),
}


@dataclass(frozen=True)
class Cell:
    """Mean and sample standard deviation (NaN for one) over the cases with a finite value, and how many failed."""

    mean: float
    deviation: float
    failed: int

    def __str__(self) -> str:
        failed = f" [{self.failed} failed]" if self.failed else ""
        if math.isnan(self.mean):
            return f"-{failed}"
        deviation = "" if math.isnan(self.deviation) else f" ({self.deviation:.2f})"
        return f"{self.mean:.2f}{deviation}{failed}"


def scores_of(prediction: Tensor, truth: Tensor, spacing_mm: Sequence[float]) -> dict[str, float | bool]:
    """`sdm.metrics.evaluate_segmentation` as plain numbers, infinities and all."""
    scores: SegmentationScores = evaluate_segmentation(prediction, truth, spacing_mm)
    return asdict(scores)


def mean_of(cases: Sequence[Mapping[str, float | bool]]) -> dict[str, float | bool]:
    """Means of scores over their finite values, as one case: infinite where all are, NaN where none says anything."""
    means: dict[str, float | bool] = {}
    for column in COLUMNS:
        values = [float(case[column]) for case in cases if not math.isnan(case[column])]
        finite = [value for value in values if math.isfinite(value)]
        means[column] = statistics.fmean(finite) if finite else math.inf if values else math.nan
    return {**means, "failed": any(case["failed"] for case in cases)}


def cell(cases: Sequence[Mapping[str, float | bool]], column: str) -> Cell:
    """One cell of a table.

    A failed case (an empty prediction) counts as 0 where more is better. It has no finite distance, so it is left out
    of a mean of distances, and counted: such a mean is to be read with the count beside it. A value that is NaN, as all
    are where truth and prediction are empty, says nothing, and is left out.
    """
    factor = COLUMNS[column][1]
    values = [factor * float(case[column]) for case in cases]
    finite = [v for v in values if math.isfinite(v)]
    failed = sum(math.isinf(v) for v in values)
    if not finite:
        return Cell(math.nan, math.nan, failed)
    deviation = statistics.stdev(finite) if len(finite) > 1 else math.nan
    return Cell(statistics.fmean(finite), deviation, failed)


def table(rows: Mapping[str, Sequence[Mapping[str, float | bool]]], columns: Sequence[str], unit: str = "mm") -> str:
    """A table in Markdown: a row for each name, "mean (standard deviation)" over its cases.

    Args:
        rows: Scores of the cases by the row's name.
        columns: Keys of `COLUMNS`.
        unit: Of the distances.
    """
    heads = [f"{COLUMNS[c][0]} [{unit if COLUMNS[c][2] == 'mm' else COLUMNS[c][2]}]" for c in columns]
    lines = [f"| method | {' | '.join(heads)} |", f"|---|{'---|' * len(columns)}"]
    lines += [f"| {name} | {' | '.join(str(cell(cases, c)) for c in columns)} |" for name, cases in rows.items()]
    return "\n".join(lines)
