"""Meshes read by processes that do only that: the same bytes, lines and reports, and nobody left after a kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import trimesh

from sdm.cli import main
from sdm.cli.maps import map_readers
from sdm.cli.maps.map_readers import reading_processes
from sdm.cli.maps.map_told import tasks_of
from sdm.cli.maps.run import run
from sdm.runtime.worker_processes.pool import WorkerProcesses
from sdm.runtime.worker_processes.shared_memory import can_share
from tests.helpers.map_settings import map_settings

pytestmark = pytest.mark.skipif(not can_share(), reason="this system has no such processes")
COUNT = 12


@pytest.fixture
def folder(tmp_path) -> Path:
    """Binary and text files: meshes that differ, one open, one of a turned face, one far away, two bad ones."""
    place = tmp_path / "in"
    place.mkdir()
    for number in range(COUNT):
        ball = trimesh.creation.icosphere(1)
        ball.apply_scale([1, 1 + 0.1 * number, 1])
        faces = ball.faces.copy()
        if number == 7:
            faces = faces[:-9]
        if number == 8:
            faces[4] = faces[4][::-1]
        if number == 9:
            ball.vertices += 1e5
        ending = {4: "stl", 5: "obj"}.get(number, "ply")
        more = {"encoding": "ascii"} if number == 6 else {}
        trimesh.Trimesh(ball.vertices, faces, process=False).export(place / f"{number:02}.{ending}", **more)
    (place / "03.ply").write_bytes((place / "03.ply").read_bytes()[:-1])
    (place / "10.ply").write_bytes(b"")
    return place


def made(folder: Path, out: Path, **settings) -> tuple[dict[str, bytes], list[dict]]:
    out.mkdir(exist_ok=True)
    jobs = [(file, out / f"{file.stem}.npz") for file in sorted(folder.iterdir())]
    assert run(jobs, replace(map_settings(10), **settings), folder=out, report=out.with_suffix(".json")) == 2
    entries = json.loads(out.with_suffix(".json").read_text())["meshes"]
    return {file.name: file.read_bytes() for file in out.iterdir()}, [
        {**entry, "seconds": 0, "output": 0} for entry in entries
    ]


@pytest.mark.parametrize(
    "settings", [{}, {"dtype": "float16", "truncate": 0.5}, {"normalize": "cube"}, {"orient": "auto"}], ids=str
)
def test_the_same_files_lines_and_report(folder, tmp_path, monkeypatch, capsys, settings):
    threads, reports = made(folder, tmp_path / "threads", **settings)
    lines = capsys.readouterr()
    calls, plain = [], WorkerProcesses.call
    monkeypatch.setattr("sdm.cli.maps.run.reading_processes", lambda *_: 2)
    monkeypatch.setattr(WorkerProcesses, "call", lambda self, *given: (calls.append(given), plain(self, *given))[1])
    assert made(folder, tmp_path / "processes", **settings) == (threads, reports)
    assert len(threads) == COUNT - 2
    assert [entry.get("closed") for entry in reports].count(False) == (1 if settings.get("orient") else 2)
    # All but text that is known by its name.
    assert len(calls) == COUNT - 1
    for before, after in zip(lines, capsys.readouterr(), strict=True):
        assert [words(line) for line in after.replace("processes", "threads").splitlines()] == [
            words(line) for line in before.splitlines()
        ]


def test_where_no_process_can_be_begun_threads_read(folder, tmp_path, monkeypatch):
    threads = made(folder, tmp_path / "threads")

    def none(*_: object) -> None:
        raise BlockingIOError("Resource temporarily unavailable")

    monkeypatch.setattr("sdm.cli.maps.run.reading_processes", lambda *_: 2)
    monkeypatch.setattr("sdm.runtime.worker_processes.pool._started", none)
    assert made(folder, tmp_path / "again") == threads


def words(line: str) -> str:
    """A line without its times."""
    return line.partition(" voxels")[0]


def test_a_restart_knows_the_maps(folder, tmp_path, monkeypatch, capsys):
    made(folder, tmp_path / "out")
    monkeypatch.setattr("sdm.cli.maps.run.reading_processes", lambda *_: 2)
    capsys.readouterr()
    made(folder, tmp_path / "out", resume=True)
    assert capsys.readouterr().out.count("is there already") == COUNT - 2


BY_PROCESSES = """
import sys
from sdm.cli import main
from sdm.cli.maps import run
run.reading_processes = lambda *_: 2
sys.exit(main())
"""


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["interrupt", "reader", "parent"])
def test_what_is_cut_off_leaves_no_process_and_is_made_good_by_a_restart(folder, tmp_path, victim):
    for number in range(COUNT, 10 * COUNT):
        (folder / f"{number}.ply").write_bytes((folder / "00.ply").read_bytes())
    out, options = tmp_path / "out", ["compute", str(folder), "--format", "npz", "--resolution", "64", "--skip-bad"]
    command = [sys.executable, "-W", "ignore", "-c", BY_PROCESSES, *options, "-o", out, "--device", "cpu"]
    child = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    limit = time.monotonic() + 100
    while not list(out.glob("[0-9]*.npz")) and time.monotonic() < limit:
        time.sleep(0.005)
    readers = [int(word) for word in Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()]
    assert len(readers) == 2
    if victim == "interrupt":
        # As a terminal does it, to the whole group.
        os.killpg(child.pid, signal.SIGINT)
    else:
        for number in [child.pid] if victim == "parent" else readers:
            os.kill(number, signal.SIGKILL)
    said = child.communicate(timeout=60)[1]
    assert "Traceback" not in said
    if victim == "reader":
        assert "sdm: a worker process died (exit code -9); --resume goes on from there" in said
    assert child.returncode == {"interrupt": 130, "reader": 2, "parent": -9}[victim]
    while any(Path(f"/proc/{number}").exists() for number in readers) and time.monotonic() < limit:
        time.sleep(0.01)
    assert not any(Path(f"/proc/{number}").exists() for number in readers)
    assert main([*options, "-o", str(out), "--device", "cpu", "--resume"]) == 0
    assert main([*options, "-o", str(tmp_path / "whole"), "--device", "cpu"]) == 0
    names = sorted(file.name for file in (tmp_path / "whole").glob("*.npz"))
    assert sorted(file.name for file in out.iterdir() if file.name != "report.json") == names
    assert all((out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes() for name in names)


@pytest.mark.parametrize(
    ("device", "cores", "ending", "count", "processes"),
    [
        ("cuda", 16, "ply", 100, 4),
        ("cuda", 16, "STL", 100, 4),
        ("cpu", 16, "ply", 100, 0),
        ("cuda", 2, "ply", 100, 0),
        ("cuda", 16, "obj", 100, 0),
        ("cuda", 16, "ply", 10, 0),
    ],
)
def test_who_has_them(monkeypatch, device, cores, ending, count, processes):
    monkeypatch.setattr("sdm.runtime.pipeline.thread_count.cores", lambda: cores)
    settings = replace(map_settings(64), device=torch.device(device))
    tasks = tasks_of([(Path(f"{number}.{ending}"), Path(f"{number}.npz")) for number in range(count)])
    assert reading_processes(settings, tasks) == processes
    monkeypatch.setattr(map_readers, "known", lambda: (0,))
    assert reading_processes(settings, tasks) == 0
