"""Progress on a terminal: a bar with what is done, and lines that stay above it."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

from sdm.cli.common import progress as progress_module

PROGRAM = """
from sdm.cli.common.progress import CountProgress, FileProgress
{body}
"""
COUNT = """
with CountProgress("maps") as progress:
    for done in range(4):
        progress(done, 3)
"""
FILES = """
with FileProgress(2) as progress:
    for name in ("[a].ply", "b.ply"):
        progress.begin(name)
        progress.share(0.5)
        progress.print(f"{name} is done")
        progress.end()
"""


@pytest.mark.parametrize(
    ("body", "texts"), [(COUNT, ["3 of 3 maps"]), (FILES, ["[a].ply is done", "b.ply is done"])], ids=["count", "files"]
)
def test_on_a_terminal(body, texts):
    shown, terminal = pty.openpty()
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(body=body)],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "120"},
    )
    os.close(terminal)
    said = b""
    try:
        while chunk := os.read(shown, 4096):
            said += chunk
    except OSError:  # the terminal's other end is closed
        pass
    os.close(shown)
    assert program.wait() == 0
    assert "━" in said.decode()
    for text in texts:
        assert text in said.decode()


def test_in_a_pipe_there_is_no_bar():
    program = [sys.executable, "-c", PROGRAM.format(body=FILES)]
    done = subprocess.run(program, check=True, capture_output=True, text=True)
    assert done.stdout.splitlines() == ["[a].ply is done", "b.ply is done"]
    assert done.stderr == ""


def test_the_stage_that_limits_is_named():
    body = """
from sdm.cli.common import progress as module
from sdm.runtime.pipeline.stage_times import StageTimes
module.LOG_INTERVAL = 0.0
times = StageTimes()
times.declare("read", 1)
with times.busy("read"):
    pass
with CountProgress("maps", times) as progress:
    progress(0, 4)
    progress(2, 4)
"""
    done = subprocess.run([sys.executable, "-c", PROGRAM.format(body=body)], check=True, capture_output=True, text=True)
    assert done.stderr.startswith("sdm: 2 of 4 maps, ")
    assert done.stderr.endswith(" left, read limits\n")


def test_where_the_clock_ends_a_count_the_time_left_is_the_clock_s(monkeypatch, capsys):
    now = 100.0
    monkeypatch.setattr(progress_module, "LOG_INTERVAL", 0.0)
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now)
    with progress_module.CountProgress("steps", budget_s=60.0) as progress:
        progress(0, 1_000_000)
        now = 140.0
        progress(20, 1_000_000)
    assert capsys.readouterr().err == "sdm: 20 steps, 0.5 a second, 0:00:20 left\n"
    with progress_module.CountProgress("steps", budget_s=600.0) as progress:
        progress(0, 40)
        now = 180.0
        progress(20, 40)
    assert capsys.readouterr().err == "sdm: 20 of 40 steps, 0.5 a second, 0:00:40 left\n"
