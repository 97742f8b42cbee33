"""Space of files: taken for what is not written yet, given back of what is, and refused without an error."""

from __future__ import annotations

import os

import pytest

from sdm.runtime import file_space
from sdm.runtime.file_space import give_space_back, take_space

SIZE = 1 << 22


def test_taken_and_given_back(tmp_path):
    with (tmp_path / "a").open("w+b", buffering=0) as file:
        if not take_space(file.fileno(), SIZE):
            pytest.skip("the file system takes no space beforehand")
        status = os.fstat(file.fileno())
        assert status.st_size == SIZE
        assert 512 * status.st_blocks >= SIZE
        file.write(b"a" * SIZE)
        assert give_space_back(file.fileno(), SIZE // 2)
        file.seek(0)
        assert file.read() == bytes(SIZE // 2) + b"a" * (SIZE // 2)
        os.fsync(file.fileno())
        assert 512 * os.fstat(file.fileno()).st_blocks < SIZE


def test_where_there_is_none(tmp_path, monkeypatch):
    with (tmp_path / "a").open("wb") as file:
        assert not take_space(file.fileno(), 1 << 60)
        monkeypatch.setattr(file_space, "_fallocate", lambda: None)
        assert not take_space(file.fileno(), SIZE)
        assert not give_space_back(file.fileno(), SIZE)
    assert (tmp_path / "a").read_bytes() == b""
