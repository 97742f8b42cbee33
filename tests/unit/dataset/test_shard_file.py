"""Files of a shard are byte for byte those that Zarr itself writes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sdm.dataset import layout, shard_paths
from sdm.dataset.shard_file import maps_content, rows_content
from sdm.dataset.shard_writer import DTYPES


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize("rows", [5, 3])
@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize(("compression", "version"), [("zstd", 3), ("zstd", 2), ("none", 3)])
def test_bytes_are_those_of_zarr(rows, dtype, compression, version, direct, tmp_path, monkeypatch):
    if not direct:
        monkeypatch.setattr("sdm.dataset.compressor.direct_call", lambda: None)
    # Two maps a task, and fewer on the way than there are.
    monkeypatch.setattr("sdm.dataset.shard_file.TASK", 2 * 20 * 21 * 22 * np.dtype(dtype).itemsize)
    monkeypatch.setattr("sdm.dataset.shard_file.AHEAD", 1)
    maps = np.random.default_rng(0).normal(size=(rows, 20, 21, 22)).astype(dtype)
    # Of some, what compresses well, and what is all zeros.
    maps[1] = np.round(maps[1])
    maps[2] = 0
    manifest = {
        "version": version,
        "recipe": {"dtype": dtype, "grid": {"shape": list(maps.shape[1:])}},
        "count": rows,
        "shard": 5,
        "compression": compression,
    }
    layout._sdm_array(tmp_path / "sdm", rows, maps.shape[1:], manifest)[:] = maps
    expected = shard_paths.file_of(tmp_path, "sdm", 0).read_bytes()
    for threads in (1, 3):
        with ThreadPoolExecutor(threads) as pool:
            found = b"".join(bytes(piece) for some in maps_content(maps, manifest, pool) for piece in some)
            assert found == expected


@pytest.mark.parametrize("version", [1, 2])
def test_rows_of_numbers_too(version, tmp_path):
    manifest = {"version": version, "shard": 5}
    for name, shape in (("theta", (3, 4)), ("transform", (5, 4, 4))):
        values = np.random.default_rng(1).normal(size=shape).astype(DTYPES[name])
        padded = np.zeros((5, *shape[1:]), values.dtype)
        padded[: len(values)] = values
        layout._rows_array(tmp_path / name, padded.shape, DTYPES[name], manifest)[:] = padded
        expected = shard_paths.file_of(tmp_path, name, 0).read_bytes()
        assert rows_content(values, manifest, DTYPES[name]) == expected
