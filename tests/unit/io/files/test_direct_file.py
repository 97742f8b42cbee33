"""Files past the system's cache hold what was written, whatever its size, and where a system has no such files, too."""

from __future__ import annotations

import errno
import os

import pytest

from sdm.io.files import direct_file
from sdm.io.files.direct_file import BLOCK, DirectFile

ROOM = 4 * BLOCK


@pytest.fixture(autouse=True, params=[False, True], ids=["itself", "beside"])
def small(monkeypatch, request):
    """A buffer of a few blocks, and no file too small; written by the caller, or by another thread."""
    monkeypatch.setattr(direct_file, "ROOM", ROOM)
    # Memory that is used again, of this size: none may be left for whoever writes next in this process.
    monkeypatch.setattr(direct_file, "_spare", [])
    monkeypatch.setattr(direct_file, "LEAST", 0)
    monkeypatch.setattr(direct_file, "LEAST_BESIDE", 0 if request.param else 1 << 40)


def written(path, content: bytes, step: int) -> bytes:
    path.write_bytes(b"older and longer" * 9999)
    with DirectFile(path, len(content)) as file:
        for begin in range(0, len(content), 3 * step):
            part = content[begin : begin + 3 * step]
            file.write_all([memoryview(part)[at : at + step] for at in range(0, len(part), step)])
    return path.read_bytes()


@pytest.mark.parametrize("size", [0, 1, BLOCK - 1, BLOCK, ROOM - 1, ROOM, ROOM + 1, 2 * ROOM, 3 * ROOM + BLOCK + 7])
@pytest.mark.parametrize("step", [100, BLOCK, ROOM, 5 * ROOM])
def test_any_size_in_any_pieces(size, step, tmp_path):
    content = os.urandom(size)
    assert written(tmp_path / "a", content, step) == content


def test_where_such_files_are_refused(tmp_path, monkeypatch):
    content, plain = os.urandom(2 * ROOM + 5), os.open

    def refuse(path, flags, *more, **options):
        if flags & getattr(os, "O_DIRECT", 0):
            raise OSError(errno.EINVAL, "no")
        return plain(path, flags, *more, **options)

    monkeypatch.setattr(os, "open", refuse)
    assert written(tmp_path / "a", content, 1000) == content


@pytest.mark.skipif(not hasattr(os, "O_DIRECT"), reason="Linux")
def test_a_disk_of_larger_blocks(tmp_path, monkeypatch):
    content, plain, refused = os.urandom(3 * ROOM + 5), os.pwrite, []
    monkeypatch.setattr(direct_file, "_opened_directly", lambda path: os.open(path, os.O_WRONLY | os.O_TRUNC))

    def pwrite(handle, some, begin):
        if begin == ROOM + BLOCK and begin not in refused:
            refused.append(begin)
            raise OSError(errno.EINVAL, "no")
        # One block is taken before.
        return plain(handle, some[:BLOCK] if begin == ROOM else some, begin)

    monkeypatch.setattr(os, "pwrite", pwrite)
    assert written(tmp_path / "a", content, 1000) == content
    assert refused


@pytest.mark.skipif(not hasattr(os, "O_DIRECT"), reason="Linux")
@pytest.mark.parametrize("rooms", [1, 2, 3])
def test_a_disk_that_is_full(tmp_path, monkeypatch, rooms):
    """Whoever writes hears of it, and not later than when the file is closed."""
    monkeypatch.setattr(direct_file, "_opened_directly", lambda path: os.open(path, os.O_WRONLY | os.O_CREAT))
    plain = os.pwrite

    def pwrite(handle, some, begin):
        if begin >= (rooms - 1) * ROOM:
            raise OSError(errno.ENOSPC, "full")
        return plain(handle, some, begin)

    monkeypatch.setattr(os, "pwrite", pwrite)
    with pytest.raises(OSError, match="full"), DirectFile(tmp_path / "a", 3 * ROOM) as file:
        for _ in range(3):
            file.write(bytes(ROOM))
    assert file._file.closed


def test_an_error_leaves_no_open_file(tmp_path):
    with pytest.raises(KeyError), DirectFile(tmp_path / "a", 1) as file:
        file.write(b"abc")
        raise KeyError
    assert file._file.closed
