from __future__ import annotations

import gzip
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sdm.io.files import gzip_packer
from sdm.io.files.gzip_packer import packed


def pieces(*sizes):
    values = np.random.default_rng(0)
    # Half of them noise, which takes more room packed than plain.
    return [values.integers(0, 256 if number % 2 else 8, size, dtype=np.uint8) for number, size in enumerate(sizes)]


def content(given):
    return b"".join(bytes(part) for part in packed(iter(given)))


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize("sizes", [(), (0, 0), (352, 8_000), (1, gzip_packer.ROOM + 5, 7, gzip_packer.ROOM)])
def test_what_is_packed_is_unpacked(monkeypatch, direct, sizes):
    if not direct:
        monkeypatch.setattr(gzip_packer, "direct_call", lambda: None)
    given = pieces(*sizes)
    assert gzip.decompress(content(given)) == b"".join(piece.tobytes() for piece in given)


def test_threads_do_not_change_bytes():
    several = [pieces(352, 100_000 + number) for number in range(16)]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(content, several)) == [content(given) for given in several]


def test_neither_a_name_nor_a_time_is_in_it():
    head = content(pieces(10))[:10]
    assert head[:4] == b"\x1f\x8b\x08\x00"
    assert head[4:8] == bytes(4)
