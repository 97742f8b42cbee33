from __future__ import annotations

import os
import subprocess
import sys

import pytest
import trimesh

from sdm.cli import main
from sdm.io.files import atomic
from sdm.io.files.leftovers import remove_leftovers, remove_leftovers_of

KILLED = """
import os, sys
from pathlib import Path
from sdm.io.files.atomic import replacing

with replacing(Path(sys.argv[1])) as part:
    part.write_text("half")
    os._exit(9)
"""


def names(folder):
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


@pytest.fixture
def deep(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    return tmp_path


@pytest.mark.skipif(os.name == "nt", reason="there nothing is removed")
def test_what_a_killed_process_left_goes(deep):
    subprocess.run([sys.executable, "-c", KILLED, str(deep / "a" / "b" / "map.npz")], check=False)
    assert len(names(deep)) == 1
    remove_leftovers(deep)
    assert not names(deep)


@pytest.mark.skipif(os.name == "nt", reason="there nothing is removed")
def test_what_a_killed_process_left_of_one_file_goes(tmp_path):
    for name in ("map.npz", "other.npz"):
        subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / name)], check=False)
    own = atomic.own_name(tmp_path / "map.npz")
    own.write_text("half")
    remove_leftovers_of(tmp_path / "map.npz")
    other, ours = sorted(tmp_path.iterdir(), key=lambda path: path == own)
    assert (other.name.startswith(".other.npz."), ours) == (True, own)


@pytest.mark.skipif(os.name == "nt", reason="there nothing is removed")
@pytest.mark.parametrize("command", ["compute", "watertight", "generate"])
def test_the_next_takes_away_what_a_killed_one_left_of_its_only_output(command, tmp_path):
    trimesh.creation.icosphere(1).export(tmp_path / "ball.ply")
    source, target, more = {
        "compute": (tmp_path / "ball.ply", "map.npz", ["--resolution", "8", "--resume"]),
        "watertight": (tmp_path / "ball.ply", "closed.ply", ["--resolution", "8"]),
        "generate": ("cuboid", "d.zarr", ["--count", "2", "--resolution", "8", "--resume"]),
    }[command]
    written = tmp_path / f"{target}.part" if command == "generate" else tmp_path / target
    subprocess.run([sys.executable, "-c", KILLED, str(written)], check=False)
    words = [command, str(source), "-o", str(tmp_path / target), "--device", "cpu", *more]
    assert main(words) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["ball.ply", target])


@pytest.mark.parametrize("other", ["machine", "process", "name"])
def test_what_somebody_else_writes_stays(deep, monkeypatch, other):
    part = atomic.own_name(deep / "a" / "map.npz")
    if other == "machine":
        with monkeypatch.context() as patch:
            # No process has this number.
            patch.setattr(atomic.os, "getpid", lambda: 1 << 30)
            patch.setattr(atomic, "machine", lambda: "0" * 8)
            part = atomic.own_name(deep / "a" / "map.npz")
    elif other == "name":
        part = deep / "a" / f".map.npz.{1 << 30}.part"
    part.write_text("half")
    remove_leftovers(deep)
    assert names(deep) == [part.name]
