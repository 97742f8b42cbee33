"""Who makes a dataset."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from sdm.core.grid import Grid
from sdm.dataset.writer import processes_of
from sdm.runtime.sharing import process_count


@pytest.fixture(autouse=True)
def many_cores(monkeypatch):
    monkeypatch.setattr(process_count, "cores", lambda: 32)


def job(resolution: int) -> Any:
    grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (resolution,) * 3)
    return SimpleNamespace(grid=grid, dtype=torch.float32)


@pytest.mark.parametrize(
    ("resolution", "maps", "processes"),
    # One GPU has ended when the other would have started, whatever the shapes.
    [(64, 500, 1), (64, 5_000, 2), (64, 100_000, 2), (256, 100_000, 2)],
)
def test_long_work_has_a_process_for_each_gpu(resolution, maps, processes):
    assert len(processes_of(job(resolution), maps, ["cuda:0", "cuda:1"])) == processes


def test_the_engine_of_a_cpu_has_all_of_it():
    assert processes_of(job(64), 100_000, ["cpu"]) == ["cpu"]
