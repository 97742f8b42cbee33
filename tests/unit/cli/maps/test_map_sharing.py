"""Processes that are started before torch is imported: when, and what becomes of them."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
import trimesh

from sdm.cli.maps import map_sharing
from sdm.cli.maps.map_sharing import early_processes
from sdm.cli.maps.run import run
from sdm.runtime.sharing import process_count, processes
from sdm.runtime.sharing.process_count import gpus_expected
from sdm.runtime.sharing.processes import OtherProcesses, run_here
from tests.helpers.map_settings import map_settings


@pytest.fixture
def started(monkeypatch) -> list[list[str]]:
    """Devices of the processes that would be started, on a machine with one GPU and 16 cores."""
    found: list[list[str]] = []
    monkeypatch.setattr(map_sharing, "gpus_expected", lambda _: ["cuda:0"])
    monkeypatch.setattr(process_count, "cores", lambda: 16)
    monkeypatch.setattr(OtherProcesses, "start", lambda self, devices: found.append(list(devices)))
    return found


@pytest.fixture
def many(tmp_path) -> Path:
    """A folder of folders of many files that are called like meshes, and others."""
    for number in range(2000):
        place = tmp_path / "many" / str(number // 100)
        place.mkdir(parents=True, exist_ok=True)
        (place / f"{number}.PLY").touch()
        (place / f"{number}.txt").touch()
    return tmp_path / "many"


def test_many_meshes_have_processes_at_once(started, many, tmp_path):
    with early_processes([many], "auto", None) as others:
        assert others is not None
    assert started == [["cuda:0"] * 3]
    with early_processes(list(many.rglob("*.PLY")), "auto", (128,)):
        pass
    assert started == [["cuda:0"] * 3] * 2
    # Few, small, or done already.
    for meshes, resolution in (([many / "3"], None), ([many], (16,)), ([many / "3" / "300.PLY"], None), ([], None)):
        with early_processes(meshes, "auto", resolution) as others:
            assert others is None
    with early_processes([many], "auto", None, many) as others:
        assert others is None
    with early_processes([many], "auto", None, tmp_path / "not there") as others:
        assert others is not None
    # Sizes that will be refused.
    for wrong in ((0,), (-5,), (1, 2), ()):
        with early_processes([many / "3"], "auto", wrong) as others:
            assert others is None


def test_gpus_that_are_expected(monkeypatch, tmp_path):
    monkeypatch.setattr(process_count, "DEVICES", tmp_path)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert gpus_expected("auto") == []
    assert gpus_expected("cuda") == []
    for name in ("nvidia0", "nvidia1", "nvidiactl", "nvidia-uvm", "null"):
        (tmp_path / name).touch()
    assert gpus_expected("auto") == ["cuda:0", "cuda:1"]
    assert gpus_expected("cuda:1") == ["cuda:1"]
    assert gpus_expected("cpu") == []
    for visible, count in (("0", 1), ("1,0", 2), ("", 0), ("-1", 0), ("GPU-abc", 1)):
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
        assert len(gpus_expected("auto")) == count


# This process has threads, which its copies have not and do not wait for.
pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")


@pytest.fixture
def forked(monkeypatch) -> None:
    """Processes that have imported everything: it is not their start that is asked about, which takes seconds."""
    fork = multiprocessing.get_context("fork")
    monkeypatch.setattr(processes.multiprocessing, "get_context", lambda _: fork)


class Shards:
    """Who did what; each process does at least one shard."""

    def maker(self, device: str) -> str:
        return device

    def run(self, shards: Iterable[int], maker: str, done: Callable[[Any], None], *, times: Any = None) -> None:
        for shard in shards:
            time.sleep(0.02)
            done((shard, os.getpid()))


@pytest.mark.usefixtures("forked")
@pytest.mark.parametrize("count", [0, 1, 3], ids=["more are started", "one is missing", "one is left over"])
def test_processes_that_have_been_started_are_used(count):
    told: list[Any] = []
    with OtherProcesses(__name__) as others:
        others.start(["cpu"] * count)
        early = [worker for worker, _ in others._workers]
        work: Any = Shards()
        run_here(work, [*range(150)], ["cpu"] * 3, told.append, others=others)
        # One more than is needed is ended at once.
        assert all(not worker.is_alive() for worker in early[2:])
    assert sorted(shard for shard, _ in told) == [*range(150)]
    assert (
        {os.getpid()} <= {pid for _, pid in told} <= {os.getpid(), *(worker.pid for worker, _ in others._workers[:2])}
    )
    assert all(not worker.is_alive() for worker in early)


@pytest.mark.usefixtures("forked")
def test_processes_that_nobody_needs_are_ended():
    with OtherProcesses(__name__) as others:
        others.start(["cpu"] * 2)
        workers = [worker for worker, _ in others._workers]
        assert all(worker.is_alive() for worker in workers)
    assert not any(worker.is_alive() for worker in workers)


@pytest.mark.usefixtures("forked")
def test_one_process_alone_keeps_no_other(tmp_path, capsys):
    """As where fewer meshes are left, or torch sees no GPU: they would hold memory all the time."""
    ball = tmp_path / "ball.ply"
    trimesh.creation.icosphere(1).export(ball)
    with OtherProcesses(__name__) as others:
        others.start(["cpu"] * 2)
        workers = [worker for worker, _ in others._workers]
        run([(ball, tmp_path / "map.npz")], map_settings(8), processes=["cpu"], others=others)
        assert not any(worker.is_alive() for worker in workers)
    assert (tmp_path / "map.npz").exists()


# The others are started before this process imports what takes long.
BEFORE = """
import sys

from sdm.cli import main
from sdm.cli.maps import map_sharing
from sdm.runtime.sharing.processes import OtherProcesses

map_sharing.gpus_expected = lambda _: ["cpu", "cpu"]
map_sharing.processes_for = lambda devices, *_, **__: devices

def start(self, devices):
    print(devices, "torch" in sys.modules)
    sys.exit(3)

OtherProcesses.start = start
if __name__ == "__main__":
    sys.exit(main())
"""


def test_torch_is_imported_afterwards(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(BEFORE)
    words = ["compute", "a.ply", "b.ply", "-o", "out", "--device", "cpu"]
    around = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])}
    told = subprocess.run(
        [sys.executable, str(script), *words], cwd=tmp_path, env=around, capture_output=True, text=True, check=False
    )
    assert (told.stdout, told.returncode) == ("['cpu'] False\n", 3), told.stderr


@pytest.mark.usefixtures("forked")
def test_work_is_taken_from_one_list():
    """Two processes that wait are handed the same list of shards."""
    todo = deque(range(5))
    job: Any = Shards()
    with OtherProcesses(__name__) as others:
        others.start(["cpu"] * 2)
        others.work(job, todo, ["cpu"] * 2)
        told = [others.hear(wait=True) for _ in range(5)]
    assert sorted(shard for shard, _ in told) == [*range(5)]
