"""The benchmark of meshes that differ: lists of shapes, no two alike, and a report of both, on a CPU."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sdm.bench.dense import ragged
from sdm.inspect import inspect_mesh


def test_lists_are_of_closed_shapes_that_differ():
    cases = ragged.list_of("wide", 6, 60, 600)
    sizes = sorted(map(len, cases))
    assert len(set(sizes)) == 6
    assert sizes[0] < 90
    assert 480 < sizes[-1] < 720
    assert all(inspect_mesh(mesh).closed for mesh in ragged.fresh(cases, "cpu"))


def test_torn_lists_have_open_shapes():
    for name, closed in (("alike", 4), ("torn", 2), ("open", 0)):
        cases = ragged.list_of(name, 4, 600, 900)
        assert sum(inspect_mesh(mesh).closed for mesh in ragged.fresh(cases, "cpu")) == closed


@pytest.mark.parametrize("asked", ["--resolution 12 --lists alike", "--points 50 --lists torn"])
def test_report(tmp_path, capsys, asked):
    out = tmp_path / "ragged.json"
    options = f"--device cpu --scale 0.03 --some 2 --runs 1 {asked}"
    ragged.main([*options.split(), "--out", str(out)])
    (row,) = json.loads(out.read_text())["rows"]
    assert row["different_from_single"] == row["wrong_signs"] == 0
    assert row["max_error"] <= 4
    assert all(np.isfinite(row[key]) and row[key] > 0 for key in ("joint", "single", "stock_sah", "stock_sah_built"))
    assert out.with_suffix(".png").exists()
    assert f"list {asked.split()[-1]}" in capsys.readouterr().out
    assert str(row[asked.split()[0].strip("-")]) == asked.split()[1]
