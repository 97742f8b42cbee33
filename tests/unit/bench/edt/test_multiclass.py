"""The comparison of distance transforms of many classes: what it compares, and its record."""

from __future__ import annotations

import json
import sys

import numpy as np

from sdm.bench.edt import multiclass


def test_record(monkeypatch, tmp_path):
    out = tmp_path / "edt.json"
    monkeypatch.setattr(sys, "argv", ["multiclass", "--device", "cpu", "--quick", "--runs", "1", "--out", str(out)])
    multiclass.main()
    (case,) = json.loads(out.read_text())["cases"]
    assert case["error"]["sdm"] < multiclass.LIMIT
    assert set(case["cpu_ms"]) >= {"sdm", "SciPy"}


def test_errors_are_found():
    right = np.ones((2, 3), np.float32)
    found = multiclass.errors({"sdm": lambda: 1.5 * right, "SciPy": lambda: right})
    assert found == {"sdm": 0.5}
