"""Maps by processes that only write: the same bytes and lines, errors of single meshes, and who has such processes."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from sdm.cli import main
from sdm.cli.maps import map_writers
from sdm.cli.maps.map_told import tasks_of
from sdm.cli.maps.map_writers import writing_processes
from sdm.cli.maps.run import run
from sdm.errors import FormatError
from sdm.io.files.atomic import replace_by
from sdm.io.files.nifti_stream import write_file
from sdm.runtime.worker_processes.rooms import SharedRooms
from sdm.runtime.worker_processes.shared_memory import can_share
from tests.helpers.map_settings import map_settings

pytestmark = pytest.mark.skipif(not can_share(), reason="this system has no memory without a name")
COUNT = 12


@pytest.fixture
def folder(tmp_path) -> Path:
    """Meshes that differ, one of them bad."""
    place = tmp_path / "in"
    place.mkdir()
    for number in range(COUNT):
        ball = trimesh.creation.icosphere(1)
        ball.apply_scale([1, 1 + 0.1 * number, 1])
        ball.export(place / f"{number:02}.ply")
    (place / "03.ply").write_bytes(b"ply\n")
    return place


def made(folder: Path, out: Path, ending: str, **settings) -> tuple[dict[str, bytes], list[Path]]:
    out.mkdir()
    # One whose file is in the way of a folder cannot be written.
    (out / f"05.{ending}").mkdir()
    jobs = [(file, out / f"{file.stem}.{ending}") for file in sorted(folder.iterdir())]
    assert run(jobs, map_settings(10, **settings)) == 2
    files = {file.name: file.read_bytes() for file in out.iterdir() if file.is_file()}
    return files, list(out.glob(".*"))


@pytest.mark.parametrize(
    ("ending", "settings"), [("npz", {}), ("npz", {"dtype": "float16"}), ("nii.gz", {}), ("nii", {})], ids=str
)
def test_the_same_files_and_lines(folder, tmp_path, monkeypatch, capsys, ending, settings):
    threads = made(folder, tmp_path / "threads", ending, **settings)
    lines = capsys.readouterr()
    monkeypatch.setattr("sdm.cli.maps.run.writing_processes", lambda *_: 2)
    # Fewer rooms than maps.
    monkeypatch.setattr(map_writers, "MOST_BYTES", 3000)
    processes = made(folder, tmp_path / "processes", ending, **settings)
    assert processes == threads
    assert len(threads[0]) == COUNT - 2
    assert not threads[1]
    said = capsys.readouterr()
    for before, after in zip(lines, said, strict=True):
        assert [words(line) for line in after.replace("processes", "threads").splitlines()] == [
            words(line) for line in before.splitlines()
        ]


def words(line: str) -> str:
    """A line without its times."""
    return line.partition(" voxels")[0]


BY_PROCESSES = """
import sys
from sdm.cli import main
from sdm.cli.maps import run
run.writing_processes = lambda *_: 2
sys.exit(main())
"""


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["interrupt", "writer", "parent"])
def test_what_is_cut_off_leaves_no_process_and_is_made_good_by_a_restart(folder, tmp_path, capsys, victim):
    out, options = tmp_path / "out", ["compute", str(folder), "--format", "nii.gz", "--resolution", "64", "--skip-bad"]
    command = [sys.executable, "-W", "ignore", "-c", BY_PROCESSES, *options, "-o", out, "--device", "cpu"]
    child = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    limit = time.monotonic() + 100
    while not list(out.glob("[0-9]*.nii.gz")) and time.monotonic() < limit:
        time.sleep(0.005)
    writers = [int(word) for word in Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()]
    assert len(writers) == 2
    if victim == "interrupt":
        # As a terminal does it, to the whole group.
        os.killpg(child.pid, signal.SIGINT)
    else:
        for number in [child.pid] if victim == "parent" else writers:
            os.kill(number, signal.SIGKILL)
    said = child.communicate(timeout=60)[1]
    assert "Traceback" not in said
    if victim == "writer":
        assert "sdm: a worker process died (exit code -9); --resume goes on from there" in said
    assert child.returncode == {"interrupt": 130, "writer": 2, "parent": -9}[victim]
    while any(Path(f"/proc/{number}").exists() for number in writers) and time.monotonic() < limit:
        time.sleep(0.01)
    assert not any(Path(f"/proc/{number}").exists() for number in writers)
    assert main([*options, "-o", str(out), "--device", "cpu", "--resume"]) == 0
    assert main([*options, "-o", str(tmp_path / "whole"), "--device", "cpu"]) == 0
    names = sorted(file.name for file in (tmp_path / "whole").glob("*.nii.gz"))
    assert len(names) == COUNT - 1
    assert sorted(file.name for file in out.iterdir() if file.name != "report.json") == names
    assert all((out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes() for name in names)


def test_a_map_larger_than_the_rooms_is_copied_elsewhere(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("sdm.cli.maps.run.writing_processes", lambda *_: 2)
    monkeypatch.setattr(map_writers, "_bytes_of_map", lambda settings: 1000)
    assert len(made(folder, tmp_path / "out", "nii.gz")[0]) == COUNT - 2


def test_rooms_of_maps_that_cannot_be_written_are_given_back(folder, tmp_path, monkeypatch, capsys):
    """More of them than rooms. An error knows where it was raised, and so the map."""
    monkeypatch.setattr("sdm.cli.maps.run.writing_processes", lambda *_: 1)
    monkeypatch.setattr(map_writers, "WRITE", "tests.helpers.misbehave:refuse")
    taken = []
    monkeypatch.setattr(SharedRooms, "take", lambda rooms: taken.append(0) or rooms._free.get(timeout=20))
    out = tmp_path / "out"
    out.mkdir()
    gc.disable()
    try:
        run([(file, out / f"{file.stem}.nii.gz") for file in sorted(folder.iterdir())], map_settings(10))
    finally:
        gc.enable()
    assert capsys.readouterr().err.count("the disk is full") == len(taken) == COUNT - 1


def test_what_cannot_be_written_is_left_as_it_was(tmp_path):
    target = tmp_path / "a.nii.gz"
    target.write_bytes(b"before")
    with pytest.raises(ValueError, match="unpack"):
        replace_by(target, write_file, (b"head", np.zeros(3, np.float32)))
    assert [file.name for file in tmp_path.iterdir()] == ["a.nii.gz"]
    assert target.read_bytes() == b"before"
    with pytest.raises(FormatError, match=r"the folder .* is not there"):
        replace_by(tmp_path / "none" / "a.nii.gz", write_file, (b"head", np.zeros((1, 1, 1), np.float32)))


@pytest.mark.parametrize(
    ("change", "ending", "count", "processes"),
    [
        ({}, "nii.gz", 100, 24),
        ({"device": torch.device("cpu")}, "nii.gz", 100, 0),
        # Few, of unknown sizes, large, bands, and formats that are only written.
        ({}, "nii.gz", 10, 0),
        ({"resolution": None, "spacing": 0.1}, "nii.gz", 100, 0),
        ({"resolution": 512}, "nii.gz", 100, 0),
        ({"band": 3.0}, "nii.gz", 100, 0),
        ({}, "npz", 100, 0),
    ],
)
def test_who_has_them(monkeypatch, change, ending, count, processes):
    monkeypatch.setattr(map_writers, "threads_beside", lambda device: 16)
    settings = replace(map_settings(64), **{"device": torch.device("cuda"), **change})
    tasks = tasks_of([(Path(f"{number}.ply"), Path(f"{number}.{ending}")) for number in range(count)])
    assert writing_processes(settings, tasks) == processes
