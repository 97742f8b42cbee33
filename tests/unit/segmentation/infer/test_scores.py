"""Cells of tables: failures are counted, never averaged away in silence."""

from __future__ import annotations

import math

import pytest
import torch

from sdm.segmentation import cell, scores_of, table


def test_mean_and_deviation():
    cases = [{"dice": 0.8}, {"dice": 0.9}]
    assert str(cell(cases, "dice")) == "85.00 (7.07)"
    assert str(cell(cases[:1], "dice")) == "80.00"


def test_an_empty_prediction_is_a_failure():
    truth = torch.zeros(8, 8, 8, dtype=torch.bool)
    truth[2:6, 2:6, 2:6] = True
    failed, perfect = (scores_of(p, truth, (1.0, 1.0, 1.0)) for p in (torch.zeros_like(truth), truth))
    assert cell([failed, perfect], "dice").mean == 50
    distance = cell([failed, perfect], "hausdorff95_mm")
    assert (distance.mean, distance.failed) == (0.0, 1)
    assert str(distance) == "0.00 [1 failed]"
    assert math.isnan(cell([failed], "hausdorff95_mm").mean)
    assert str(cell([failed], "hausdorff95_mm")) == "- [1 failed]"


def test_a_table():
    rows = {"one": [{"dice": 0.5, "hausdorff95_mm": 2.0}], "two": [{"dice": 1.0, "hausdorff95_mm": 1.0}]}
    lines = table(rows, ("dice", "hausdorff95_mm"), unit="voxels").splitlines()
    assert lines == [
        "| method | Dice [%] | 95HD [voxels] |",
        "|---|---|---|",
        "| one | 50.00 | 2.00 |",
        "| two | 100.00 | 1.00 |",
    ]


def test_spacing_matters():
    first = torch.zeros(8, 8, 8, dtype=torch.bool)
    first[2:6, 2:6, 2:4] = True
    second = first.roll(1, 2)
    assert scores_of(first, second, (1.0, 1.0, 3.0))["hausdorff95_mm"] == pytest.approx(3.0)
