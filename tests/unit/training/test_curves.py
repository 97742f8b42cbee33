"""Curves are JSON lines, which a training that goes on adds to, and TensorBoard's events where it is installed."""

from __future__ import annotations

import json
import math
import sys

import pytest

from sdm.training.curves import Curves


def lines(folder):
    return [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]


def test_points_are_lines_of_what_is_finite(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    Curves(tmp_path / "a").add({"step": 1, "loss": 0.5, "mae": math.nan})
    Curves(tmp_path / "a").add({"step": 2, "loss": 0.25})
    assert lines(tmp_path / "a") == [{"step": 1, "loss": 0.5}, {"step": 2, "loss": 0.25}]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["curve.jsonl"]


def test_nowhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Curves(None).add({"step": 1, "loss": 0.5})
    assert not list(tmp_path.iterdir())


def test_events_of_tensorboard(tmp_path):
    pytest.importorskip("tensorboard")
    Curves(tmp_path).add({"step": 1, "loss": 0.5})
    assert list(tmp_path.glob("events.out.tfevents.*"))
