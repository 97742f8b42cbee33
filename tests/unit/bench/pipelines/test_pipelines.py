"""The comparison of pipelines: what it compares, and its record."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec

import pytest
import torch

from sdm.bench.pipelines import __main__ as pipelines
from sdm.bench.pipelines.libraries import scipy_maps

NAMES = {"monai": "MONAI", "torchio": "TorchIO", "batchgeneratorsv2": "batchgeneratorsv2"}


def test_record(monkeypatch, tmp_path):
    there = [name for module, name in NAMES.items() if find_spec(module)]
    if not there:
        pytest.skip("none of MONAI, TorchIO and batchgeneratorsv2 is installed")
    out = tmp_path / "pipelines.json"
    monkeypatch.setattr(sys, "argv", ["x", "--device", "cpu", "--quick", "--samples", "1", "--out", str(out)])
    pipelines.main()
    cases = json.loads(out.read_text())["cases"]
    assert [case["library"] for case in cases] == there
    for case in cases:
        assert case["error"] < pipelines.LIMIT
        assert all(case[kind]["samples_per_s"] > 0 for kind in pipelines.KINDS)


def test_differences_are_found():
    labels = torch.zeros(1, 6, 5, 4, dtype=torch.uint8)
    labels[0, 2:4, 1:3, 1:3] = 1
    right = scipy_maps(labels, 1, (1.0, 2.0, 3.0))
    made = {"sdm": lambda labels, seed: right * 1.5, "SciPy": lambda labels, seed: right}
    assert abs(pipelines.difference(made, labels) - 0.5) < 1e-6
    assert (scipy_maps(labels, 2, (1.0, 2.0, 3.0))[1] == 0).all()
