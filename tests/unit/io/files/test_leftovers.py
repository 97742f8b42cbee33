from __future__ import annotations

import os
import subprocess
import sys

import pytest

from sdm.io.files import atomic
from sdm.io.files.leftovers import remove_leftovers

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
