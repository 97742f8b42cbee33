"""Shards by processes that do nothing else: the same bytes, little to import, and every way to be cut off."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from sdm.dataset import generate, layout, shard_job, shard_stage
from sdm.dataset.manifest import read_manifest
from sdm.errors import FormatError, SDMError
from sdm.runtime.worker_processes.pool import WorkerProcesses
from sdm.runtime.worker_processes.shared_memory import can_share
from sdm.shapes import Cochlea
from tests.helpers import generate_command
from tests.unit.dataset.test_resume import contents

pytestmark = pytest.mark.skipif(not can_share(), reason="this system has no memory without a name")
FAMILY = Cochlea(600)


def write(path: Path, count: int = 11, **options):
    return generate(FAMILY, FAMILY.grid(10), count, path, **{"device": "cpu", "shard": 2, **options})


@pytest.fixture
def started(monkeypatch) -> list[WorkerProcesses]:
    """Shards are written by processes, which are listed here."""
    several: list[WorkerProcesses] = []

    class Noted(WorkerProcesses):
        def __init__(self, *given, **more):
            super().__init__(*given, **more)
            several.append(self)

    monkeypatch.setattr(shard_stage, "WorkerProcesses", Noted)
    monkeypatch.setattr(
        shard_job, "shard_writers", lambda *where, shards, local: shard_stage.process_writers(*where, count=2)
    )
    return several


@pytest.mark.parametrize(("dtype", "compression"), [("float32", "zstd"), ("float16", "none")])
def test_the_same_bytes(tmp_path, monkeypatch, started, dtype, compression):
    how = {"dtype": getattr(torch, dtype), "compression": compression}
    by_processes = contents(write(tmp_path / "processes.zarr", **how))
    assert len(started) == 1
    monkeypatch.undo()
    assert by_processes == contents(write(tmp_path / "threads.zarr", **how))


def test_one_that_is_killed_is_said_and_loses_what_it_had(tmp_path, monkeypatch, started):
    target = tmp_path / "d.zarr"

    def kill(done: int, total: int) -> None:
        if done:
            for worker in started[0]._workers:
                worker.process.kill()

    with pytest.raises(SDMError, match=r"a worker process died \(exit code -9\); --resume goes on from there"):
        write(target, 99, progress=kill)
    part = layout.part_of(target)
    manifest = read_manifest(part)
    done = [n for n in range(50) if layout.is_done(part, manifest, n)]
    assert 0 < len(done) < 50
    assert all(layout.is_sound(part, manifest, n) for n in done)
    # Small files that one was writing go when the dataset is finished.
    assert not [left for left in part.rglob("*.part") if left.is_dir()]
    monkeypatch.undo()
    assert contents(write(target, 99, resume=True)) == contents(write(tmp_path / "whole.zarr", 99))
    assert not list(target.rglob(".*.part"))


def test_a_disk_that_cannot_be_written_is_said(tmp_path, started):
    target = tmp_path / "d.zarr"

    def in_the_way(done: int, total: int) -> None:
        if done:
            (layout.part_of(target) / "sdm/c/49").touch()

    with pytest.raises(FormatError, match=f"{os.strerror(errno.EEXIST)}|{os.strerror(errno.ENOTDIR)}; --resume"):
        write(target, 99, progress=in_the_way)


def test_an_interrupt_leaves_no_process(tmp_path):
    target = tmp_path / "d.zarr"
    options = ["--count", "20000", "--resolution", "24", "--triangles", "600", "--shard", "2", "--device", "cpu"]
    command = [*generate_command.words("processes"), "cochlea", *options, "-o", target]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    limit = time.monotonic() + 100
    while not list(layout.part_of(target).glob("sha256/c/*/0")) and time.monotonic() < limit:
        time.sleep(0.01)
    assert child.poll() is None
    workers = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()
    # As a terminal does it: to the whole group.
    os.killpg(child.pid, signal.SIGINT)
    said = child.communicate(timeout=30)[1]
    assert child.returncode == 130
    assert "Traceback" not in said
    assert len(workers) == 2
    assert not any(Path(f"/proc/{number}").exists() for number in workers)


def test_processes_import_neither_torch_nor_warp():
    script = "import json, sys, sdm.dataset.shard_writer, sdm.runtime.worker_processes.serve\n"
    script += "print(json.dumps([*sys.modules]))"
    names = json.loads(subprocess.run([sys.executable, "-c", script], check=True, capture_output=True).stdout)
    assert not {"torch", "warp", "zarr", "nibabel", "scipy"} & set(names)


@pytest.mark.parametrize(
    ("device", "cores", "shards", "local", "way"),
    [
        ("cuda", 16, 100, True, "process_writers"),
        ("cuda", 2, 100, True, "thread_writers"),
        # They would start for little.
        ("cuda", 16, 4, True, "thread_writers"),
        # At an address.
        ("cuda", 16, 100, False, "thread_writers"),
        ("cpu", 32, 100, True, "thread_writers"),
    ],
)
def test_who_writes(monkeypatch, device, cores, shards, local, way):
    monkeypatch.setattr(shard_stage, "threads_beside", lambda device: cores)
    for name in ("process_writers", "thread_writers"):
        monkeypatch.setattr(shard_stage, name, lambda *where, name=name, **more: name)
    where = Path("d"), {}, Path("scratch"), torch.device(device)
    assert shard_stage.shard_writers(*where, shards=shards, local=local) == way
