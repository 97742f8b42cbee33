"""Processes that share work: how they are started."""

from __future__ import annotations

import os
import subprocess
import sys
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import pytest

from sdm.runtime.sharing.processes import run_here


class Work:
    """As large as the names of some thousand files."""

    def __init__(self) -> None:
        self.names = b"x" * 200_000


class Started(Exception):
    pass


def test_a_start_does_not_wait_for_the_work_to_be_read(monkeypatch):
    # Whoever starts a process waits until it has read what a pipe does not hold, once it has imported everything.
    handed: list[Any] = []

    def start(process: Any) -> None:
        handed.extend(process._args)
        raise Started

    monkeypatch.setattr(SpawnProcess, "start", start)
    work: Any = Work()
    with pytest.raises(Started):
        run_here(work, [0, 1], ["cpu", "cpu"], print)
    assert handed
    assert not any(isinstance(each, Work | bytes) for each in handed)


DEAD_AT_ONCE = """
import os

if __name__ == "__mp_main__":
    os._exit(3)

from sdm.errors import SDMError
from sdm.runtime.sharing.processes import run_here
from tests.unit.runtime.sharing.test_processes import Work

if __name__ == "__main__":
    try:
        run_here(Work(), [0, 1], ["cpu", "cpu"], print)
    except SDMError as error:
        print(error)
"""


def test_processes_that_die_before_they_read_their_work_keep_nobody(tmp_path):
    script = tmp_path / "dead.py"
    script.write_text(DEAD_AT_ONCE)
    root = Path(__file__).parents[4]
    # What is left in a queue would keep the first process from its end.
    done = subprocess.run(
        [sys.executable, script],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "the process on cpu died (exit code 3)" in done.stdout
    assert done.returncode == 0


ENDED = """
import multiprocessing
import time

from sdm.runtime.sharing.processes import run_here


class Work:
    def maker(self, device):
        return multiprocessing.Lock()

    def run(self, shards, lock, done, *, times=None):
        next(iter(shards))
        done(1)
        time.sleep(60)


class Enough(Exception):
    pass


def enough(told):
    raise Enough


if __name__ == "__main__":
    try:
        run_here(Work(), [0, 1], ["cpu", "cpu"], enough)
    except Enough:
        print("ended")
"""


@pytest.mark.skipif(os.name == "nt", reason="locks have no names there")
def test_python_does_not_warn_of_locks_of_processes_that_are_ended(tmp_path):
    script = tmp_path / "ended.py"
    script.write_text(ENDED)
    told = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])},
        timeout=120,
        check=False,
    )
    assert told.stdout == "ended\n"
    assert not told.stderr
