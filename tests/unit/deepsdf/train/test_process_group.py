"""Two processes under torchrun train what one trains."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

WORDS = ["train", "deepsdf", "cochlea", "--count", "4", "--epochs", "12", "--batch-size", "4", "--points", "64"]
WORDS += ["--width", "16", "--device", "cpu"]


def trained(folder: Path, processes: int) -> dict[str, torch.Tensor]:
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes), "--no-python"]
    command = [sys.executable, "-m", "sdm", *WORDS, "--out", str(folder)]
    done = subprocess.run(
        [sys.executable, *launcher, *command],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return torch.load(folder / "model.pt", weights_only=True)["state"]


@pytest.mark.slow
def test_two_processes_are_one(tmp_path: Path) -> None:
    one, both = trained(tmp_path / "one", 1), trained(tmp_path / "both", 2)
    assert set(one) == set(both)
    for name, value in one.items():
        assert torch.allclose(value, both[name], atol=2e-3), name
    assert [p.name for p in sorted((tmp_path / "both").iterdir())] == ["checkpoint", "model.pt"]
