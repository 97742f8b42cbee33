"""The comparison of drop-ins: judgements of answers, and the calls of what is installed."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from sdm.bench.dropins import __main__ as dropins


def test_judgement():
    truth, winding = np.array([1.0, 1.0, 1.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.52, 1.0, 0.0])
    found = dropins.judged(np.array([1.0, 1.0, 1.0, 0.1, np.nan]), truth, winding)
    # The first is inside; the third says nothing, the fourth is on the surface.
    assert found == {"wrong_signs": 1, "sure": 3, "not_finite": 1, "largest_error": pytest.approx(0.1)}


def test_record(monkeypatch, tmp_path):
    pytest.importorskip("igl", reason="needs libigl, an extra")
    calls, _ = dropins.pairs()
    igl = {name: both for name, both in calls.items() if name.startswith("igl")}
    monkeypatch.setattr(dropins, "pairs", lambda: (igl, ["others are left out"]))
    out = tmp_path / "dropins.json"
    monkeypatch.setattr(sys, "argv", ["dropins", "--points", "60", "--meshes", "cube", "--out", str(out)])
    dropins.main()
    record = json.loads(out.read_text())
    assert len(record["cases"]) == 2
    for row in record["cases"]:
        assert row["ours"]["wrong_signs"] == 0
        assert row["ours"]["largest_error"] < 1e-12
