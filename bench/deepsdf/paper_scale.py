"""The paper's scale for scores that were taken before it was: a change of unit, shape by shape."""

from __future__ import annotations

import math
from typing import Any

from sdm.bench.deepsdf.evaluate import summary
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import box_diagonal
from sdm.deepsdf.infer.scores import POINTS
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import FormatError
from sdm.sampling.surface_points import triangle_areas

# The floor is a mean over 30,000 points, so it is near what the area says; another shape's is not.
SAME = 0.05


def in_paper_scale(part: dict[str, Any], truths: list[TriangleMesh]) -> dict[str, Any]:
    """Scores of shapes, with their Chamfer distances where a box's diagonal is 1 (see `sdm.deepsdf.infer.scores`).

    Args:
        part: `known` or `unseen` of a run's scores.
        truths: The shapes that they are scores of, in order.

    Raises:
        FormatError: They are scores of other shapes.
    """
    if part["without_a_surface"]:
        raise FormatError("shapes without a surface have no scores, so which are whose is not known; evaluate again")
    rows = [_row(row, truth) for row, truth in zip(part["rows"], truths[: len(part["rows"])], strict=True)]
    return {**part, **summary(rows), "rows": rows}


def _row(row: dict[str, float], truth: TriangleMesh) -> dict[str, float]:
    unit = UnitSphere.of(truth).normalised(truth)
    area = float(triangle_areas(unit.vertices[unit.faces.long()]).sum())
    expected = 2000 * area / (math.pi * POINTS)
    if abs(row["chamfer_floor"] / expected - 1) > SAME:
        raise FormatError(f"{truth.name} has a floor of {expected:.4g}, not {row['chamfer_floor']:.4g}: another shape")
    diagonal = box_diagonal(unit)
    names = {"chamfer_paper": "chamfer", "chamfer_paper_floor": "chamfer_floor"}
    return row | {name: row[of] / diagonal**2 for name, of in names.items()} | {"diagonal": diagonal}
