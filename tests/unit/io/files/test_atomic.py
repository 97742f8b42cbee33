from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import torch

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError
from sdm.io import FORMATS, load, save
from sdm.io.files import atomic, rename_exchange
from sdm.io.files.atomic import LEFTOVER, put, replacing
from tests.helpers.processes.forked import Forked

GRID = Grid((0, 0, 0), (1, 1, 1), (6, 5, 4))
FIELD = SDM(torch.arange(120, dtype=torch.float32).reshape(6, 5, 4), GRID, 0)
ENDINGS = list(FORMATS)


def half(field, path: Path, made_from) -> None:
    """A writer that is killed in the middle."""
    if path.name.startswith(".map.zarr"):
        path.mkdir()
        path = path / "zarr.json"
    path.write_bytes(b"half")
    os.kill(os.getpid(), signal.SIGKILL)


def save_half(path: Path, ending: str) -> None:
    setattr(FORMATS[ending].module, FORMATS[ending].writer, half)
    save(SDM(torch.zeros(GRID.shape), GRID), path)


def test_a_killed_write_leaves_nothing_under_the_final_name(tmp_path):
    new, old = tmp_path / "new", tmp_path / "old"
    new.mkdir()
    old.mkdir()
    for ending in ENDINGS:
        save(FIELD, old / f"map.{ending}")
    for folder in (new, old):
        for ending in ENDINGS:
            child = Forked(partial(save_half, folder / f"map.{ending}", ending))
            assert child.wait() == -signal.SIGKILL
    for folder in (new, old):
        left = [path for path in folder.iterdir() if path.name.endswith(LEFTOVER)]
        assert len(left) == len(ENDINGS)
        assert all(path.name.startswith(".map.") for path in left)
        for ending in ENDINGS:
            path = folder / f"map.{ending}"
            assert path.exists() == (folder == old)
            if folder == old:
                torch.testing.assert_close(load(path).values, FIELD.values, rtol=0, atol=0)
            # What is left is in nobody's way.
            save(FIELD, path)
            assert load(path).grid == GRID


@pytest.mark.parametrize("ending", ["nii.gz"])
def test_a_real_write_killed_at_any_moment(ending, tmp_path):
    path = tmp_path / f"map.{ending}"
    grid = Grid((0, 0, 0), (1, 1, 1), (256, 256, 256))
    child = Forked(lambda: save(SDM(torch.rand(grid.shape), grid), path))
    # The probe that asks whether the folder can be written is empty: wait for bytes.
    child.wait_for(lambda: any(_size(part) > 0 for part in tmp_path.glob(f".*{LEFTOVER}")))
    os.kill(child.pid, signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    assert not path.exists()
    assert len(list(tmp_path.glob(f".map.{ending}.*{LEFTOVER}"))) == 1


def _size(path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_error_on_the_way_leaves_nothing_and_keeps_the_old(error, tmp_path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(error), replacing(tmp_path / "a") as part:
        part.write_text("half")
        raise error
    with pytest.raises(error), replacing(tmp_path / "b") as part:
        part.mkdir()
        (part / "x").write_text("half")
        raise error
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "old")]


def test_a_full_disk_is_one_sentence(tmp_path):
    full = pytest.raises(FormatError, match="cannot be written: No space left on device")
    with full, replacing(tmp_path / "a"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(params=[True, False], ids=["in one step", "in two"])
def steps(request, monkeypatch):
    """File systems that exchange two names, and those that do not."""
    if not request.param:
        monkeypatch.setattr(atomic, "exchange", lambda one, other: False)


@pytest.mark.usefixtures("steps")
def test_a_folder_takes_the_place_of_an_older_one(tmp_path):
    for content in ("one", "two"):
        with replacing(tmp_path / "a") as part:
            part.mkdir()
            (part / content).write_text(content)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["two"]


REPLACE = """
import os, signal, sys
from pathlib import Path
from sdm.io.files.atomic import replacing

real = Path.rename

def rename(self, target):
    real(self, target)
    os.kill(os.getpid(), signal.SIGKILL)

Path.rename = rename
with replacing(Path(sys.argv[1])) as part:
    part.mkdir()
    (part / "new").touch()
"""


def test_an_older_folder_is_there_until_the_new_one_is(tmp_path):
    """Killed after the first renaming, where there is one."""
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    if not atomic.exchange(tmp_path / "one", tmp_path / "other"):
        pytest.skip("this file system cannot exchange two names")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "old").touch()
    subprocess.run([sys.executable, "-W", "ignore", "-c", REPLACE, str(tmp_path / "a")], check=False)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["new"]


def test_names_that_cannot_be_exchanged(tmp_path, monkeypatch):
    (tmp_path / "a").touch()
    assert not atomic.exchange(tmp_path / "a", tmp_path / "none")
    monkeypatch.setattr(rename_exchange, "_renameat2", lambda: None)
    (tmp_path / "b").touch()
    assert not atomic.exchange(tmp_path / "a", tmp_path / "b")


def test_if_the_new_folder_cannot_be_put_in_place_the_old_one_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic, "exchange", lambda one, other: False)
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "old").write_text("old")
    with pytest.raises(FormatError), replacing(tmp_path / "a") as part:
        part.mkdir()
        real = type(part).rename

        def rename(self, target):
            if self == part:
                raise OSError(5, "Input/output error")
            return real(self, target)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(type(part), "rename", rename)
            atomic._take_place(part, tmp_path / "a")
    assert (tmp_path / "a" / "old").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_paths_without_a_name(path):
    with pytest.raises(FormatError, match="is a folder; give a name in it"), replacing(Path(path)):
        pass
    with pytest.raises(FormatError, match="is a folder; give a name in it"):
        atomic.try_to_write(Path(path))


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("in_one_step", [True, False])
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_link_gives_way_and_what_it_leads_to_stays(ending, in_one_step, there, tmp_path, monkeypatch):
    if not in_one_step:
        monkeypatch.setattr(atomic, "exchange", lambda one, other: False)
    (tmp_path / "far").mkdir()
    far, near = tmp_path / "far" / f"map.{ending}", tmp_path / f"map.{ending}"
    if there:
        save(FIELD, far)
    near.symlink_to(far)
    save(SDM(FIELD.values + 1, GRID, 0), near)
    assert torch.equal(load(near).values, FIELD.values + 1)
    assert not near.is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["far", near.name]
    assert far.exists() == there
    if there:
        assert torch.equal(load(far).values, FIELD.values)


def test_what_is_put_is_there_whole_and_leaves_nothing_beside(tmp_path, monkeypatch):
    target = tmp_path / "made" / "a.bin"
    put(target, b"one")
    moved = tmp_path / "moved"
    moved.write_bytes(b"two")
    put(target, moved)
    assert target.read_bytes() == b"two"
    assert not moved.exists()
    monkeypatch.setattr(Path, "replace", _fails)
    with pytest.raises(OSError, match="no"):
        put(target, b"three")
    assert target.read_bytes() == b"two"
    assert [path.name for path in target.parent.iterdir()] == ["a.bin"]


def _fails(*given):
    raise OSError("no")


@pytest.mark.parametrize("at_most", [1, 5, 1 << 20])
@pytest.mark.parametrize("vectors", [True, False])
def test_all_pieces_are_written_whatever_a_call_takes(at_most, vectors, tmp_path, monkeypatch):
    if not vectors:
        monkeypatch.delattr(os, "writev", raising=False)
    elif not hasattr(os, "writev"):
        pytest.skip("this system has no writev")
    else:
        plain = os.writev
        monkeypatch.setattr(os, "writev", lambda handle, pieces: plain(handle, [b"".join(pieces)[:at_most]]))
    pieces = [b"one", b"", memoryview(b"twothree"), bytearray(b"four"), *[b"x"] * 2000]
    with (tmp_path / "file").open("wb", buffering=0) as file:
        atomic.write_all(file, pieces)
    assert (tmp_path / "file").read_bytes() == b"onetwothreefour" + b"x" * 2000


@pytest.mark.skipif(sys.platform != "linux", reason="other systems count letters")
@pytest.mark.parametrize("letter", ["l", "ä"])
def test_names_as_long_as_names_may_be(tmp_path, letter):
    count = (255 - len(".zarr")) // len(letter.encode())
    target = tmp_path / f"{letter * count}.zarr"
    for _ in range(2):
        # A file system that cannot exchange folders puts the old one aside, under a longer name.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(atomic, "exchange", lambda *_: False)
            save(FIELD, target)
    put(tmp_path / f"{letter * count}.txt", b"content")
    assert len(list(tmp_path.iterdir())) == 2


def test_a_full_disk_is_told_with_the_file(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=rf"No space left on device: '{tmp_path}/map'"):
        put(tmp_path / "map", b"content")


def test_a_folder_that_another_process_puts_there_meanwhile_is_replaced(tmp_path, monkeypatch):
    target, exists = tmp_path / "map.zarr", Path.exists
    save(FIELD, target)
    monkeypatch.setattr(Path, "exists", lambda self, **how: self != target and exists(self, **how))
    save(FIELD, target)
    monkeypatch.undo()
    assert [path.name for path in tmp_path.iterdir()] == ["map.zarr"]
    assert torch.equal(load(target).values, FIELD.values)
