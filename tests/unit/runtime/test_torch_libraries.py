"""Torch's libraries loaded before torch is imported: by a thread, and only by commands that will need them."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress

import pytest
import torch

from sdm.cli import main
from sdm.runtime import torch_libraries

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="libraries are loaded so on Linux alone")

LOADED = """
import os
import sys
from pathlib import Path

def loaded():
    return "libtorch_cpu.so" in Path("/proc/self/maps").read_text()
"""


def told(code: str) -> list[str]:
    command = [sys.executable, "-c", LOADED + code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()


def test_torch_finds_them_loaded():
    code = """
from sdm.runtime import torch_libraries
os.environ.pop("LD_LIBRARY_PATH", None)
torch_libraries.begin().join()
print(loaded(), "torch" in sys.modules)
import torch
print((torch.ones(3) @ torch.ones(3)).item(), torch_libraries.begin())
"""
    assert told(code) == ["True False", "3.0 None"]


def test_other_places_are_left_to_torch():
    code = """
from sdm.runtime import torch_libraries
os.environ["LD_LIBRARY_PATH"] = "/somewhere"
torch_libraries.begin().join()
print(loaded())
"""
    assert told(code) == ["False"]


def test_what_cannot_be_loaded_is_torch_s_to_say(tmp_path, monkeypatch, capfd):
    torch_libraries._load(tmp_path)
    (tmp_path / torch_libraries.GLOBAL).write_bytes(b"no library")
    torch_libraries._load(tmp_path)
    assert capfd.readouterr() == ("", "")
    assert torch_libraries.begin() is None
    monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.setattr(torch_libraries, "find_spec", lambda _: None)
    assert torch_libraries.begin() is None
    monkeypatch.setitem(sys.modules, "torch", torch)


@pytest.mark.parametrize("words", [["compute", "--help"], ["inspect", "none.ply"], ["--version"]])
def test_help_waits_for_nothing(words, tmp_path, monkeypatch):
    begun: list[bool] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(torch_libraries, "begin", lambda: begun.append(True))
    with suppress(SystemExit):
        main(words)
    assert not begun
    with suppress(SystemExit):
        main(["compute", "none.ply", "-o", "map.npz"])
    assert begun


def test_commands_with_kernels_begin_at_once():
    code = """
from sdm.cli import main
from sdm.runtime import torch_libraries

def begin():
    print("begun", "torch" in sys.modules)
    sys.exit()

torch_libraries.begin = begin
main(["compute", "none.ply", "-o", "map.npz"])
"""
    assert told(code) == ["begun False"]
