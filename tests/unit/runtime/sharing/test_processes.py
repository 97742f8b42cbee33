"""Processes that share work: how they are started, and what happens when one of them is gone."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from multiprocessing import parent_process
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import pytest

from sdm.errors import SDMError
from sdm.runtime.sharing.processes import run_here


class Work:
    """As large as the names of some thousand files; the first process is slower than the others."""

    def __init__(self) -> None:
        self.names = b"x" * 200_000

    def maker(self, device: str) -> str:
        return device

    def run(self, shards: Iterable[int], maker: str, done: Callable[[Any], None], *, times: Any = None) -> None:
        for shard in shards:
            time.sleep(0.01 if parent_process() is None else 0.001)
            done((shard, os.getpid()))


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


def done_by(script: str, tmp_path: Path) -> subprocess.CompletedProcess[str]:
    """A script that begins processes, once it has ended."""
    file, root = tmp_path / "script.py", Path(__file__).parents[4]
    file.write_text(script)
    return subprocess.run(
        [sys.executable, str(file)],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


BEGUN = """
import os
import time

if __name__ == "__mp_main__":
    {begin}

from sdm.errors import SDMError
from sdm.runtime.sharing.processes import run_here
from tests.unit.runtime.sharing.test_processes import Work

if __name__ == "__main__":
    told = []
    try:
        run_here(Work(), [*range({shards})], ["cpu", "cpu", "cpu"], told.append)
    except SDMError as error:
        print(error)
    else:
        print(sorted(shard for shard, _ in told) == [*range({shards})], {{pid for _, pid in told}} == {{os.getpid()}})
"""


def test_processes_that_die_before_they_read_their_work_keep_nobody(tmp_path):
    done = done_by(BEGUN.format(begin="os._exit(3)", shards=5000), tmp_path)
    assert done.stdout == "the process on cpu died (exit code 3); --resume goes on from there\n"
    assert done.returncode == 0


def test_the_first_works_while_others_start(tmp_path):
    """And does not wait for those that come too late."""
    done = done_by(BEGUN.format(begin="time.sleep(600)", shards=20), tmp_path)
    assert done.stdout == "True True\n"
    assert not done.stderr


@pytest.mark.slow
def test_all_of_them_work(tmp_path):
    """Every shard is told of once, whoever does it."""
    script = BEGUN.format(begin="pass", shards=5000).replace("== {os.getpid()}", ".__len__() == 3")
    assert done_by(script, tmp_path).stdout == "True True\n"


class Killed(Work):
    """Ends a process at some moment: in the middle of what it says, or as it asks for more."""

    def run(self, shards: Iterable[int], maker: str, done: Callable[[Any], None], *, times: Any = None) -> None:
        if parent_process() is None:
            # While there is work, and until it is known that the other is gone.
            for _ in shards:
                time.sleep(0.01)
            return
        next(iter(shards))
        link: Any = next(cell.cell_contents for cell in done.__closure__ or () if hasattr(cell.cell_contents, "fileno"))
        # Of a message of a thousand bytes.
        os.write(link.fileno(), (1000).to_bytes(4, "big") + b"x" * 10)
        os.kill(os.getpid(), 9)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="kills as Linux does it")
def test_who_dies_while_it_speaks_keeps_nobody():
    work: Any = Killed()
    with pytest.raises(SDMError, match=r"the process on cpu died \(exit code -9\); --resume goes on from there"):
        run_here(work, [*range(10_000)], ["cpu", "cpu"], print)


ENDED = """
import multiprocessing
import time

from sdm.runtime.sharing.processes import run_here


class Work:
    def maker(self, device):
        return multiprocessing.Lock()

    def run(self, shards, lock, done, *, times=None):
        for shard in shards:
            time.sleep(0.01)
            if multiprocessing.parent_process() is not None:
                done(shard)
                time.sleep(60)


class Enough(Exception):
    pass


def enough(told):
    raise Enough


if __name__ == "__main__":
    try:
        run_here(Work(), [*range(10_000)], ["cpu", "cpu"], enough)
    except Enough:
        print("ended")
"""


@pytest.mark.skipif(os.name == "nt", reason="locks have no names there")
def test_python_does_not_warn_of_locks_of_processes_that_are_ended(tmp_path):
    told = done_by(ENDED, tmp_path)
    assert told.stdout == "ended\n"
    assert not told.stderr
