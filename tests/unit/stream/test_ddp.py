"""The training script of the stream's page under torchrun: two processes are one, and a kill changes nothing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

# What the page says, and what a test on two cores can do.
SMALLER = {
    "GLOBAL_BATCH, STEPS, SAVED_EVERY, STATE = 64, 10_000, 500,": "GLOBAL_BATCH, STEPS, SAVED_EVERY, STATE = 8, 40, 1,",
    "gpu = torch.cuda.is_available()": "gpu = False",
    "Cochlea()": "Cochlea(600)",
    "family.grid(64)": "family.grid(6)",
}


def script(root: Path, folder: Path) -> Path:
    page = (root / "sdm" / "stream" / "README.md").read_text()
    (text,) = re.findall(r"^```python title=train.py\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    for there, here in SMALLER.items():
        assert there in text
        text = text.replace(there, here)
    folder.mkdir()
    (folder / "train.py").write_text(text)
    return folder


def launch(folder: Path, processes: int) -> subprocess.Popen[str]:
    words = ["--standalone", "--nproc-per-node", str(processes), "train.py"]
    return subprocess.Popen(
        [sys.executable, "-m", "torch.distributed.run", *words],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def losses(child: subprocess.Popen[str]) -> dict[int, float]:
    said, complaint = child.communicate(timeout=120)
    assert child.returncode == 0, complaint
    return {int(step): float(loss) for step, loss in (line.split() for line in said.splitlines())}


@pytest.mark.slow
def test_two_processes_have_the_losses_of_one(root, tmp_path):
    one = losses(launch(script(root, tmp_path / "one"), 1))
    both = losses(launch(script(root, tmp_path / "both"), 2))
    assert list(one) == list(range(1, 41))
    assert one[40] < one[1]
    assert both == pytest.approx(one, rel=1e-4)


@pytest.mark.slow
def test_a_killed_one_has_the_very_losses_of_one_that_was_not(root, tmp_path):
    folder = script(root, tmp_path / "whole")
    whole = losses(launch(folder, 1))
    folder = script(root, tmp_path / "cut")
    text = (folder / "train.py").read_text()
    # Killed in the middle of a step, two steps after the last saved state.
    cut = text.replace(
        "    loss.backward()", "    stream.position == 8 * 17 and os.kill(os.getpid(), 9)\n    loss.backward()"
    )
    (folder / "train.py").write_text(cut.replace("STATE = 8, 40, 1,", "STATE = 8, 40, 5,"))
    child = launch(folder, 1)
    child.communicate(timeout=120)
    assert child.returncode
    (folder / "train.py").write_text(text)
    assert losses(launch(folder, 1)) == {step: loss for step, loss in whole.items() if step > 15}
