"""Limits beside the pipelines: what disk, checksums and compressors do by themselves."""

from __future__ import annotations

import gzip
import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
from isal import isal_zlib
from numcodecs.blosc import SHUFFLE, Blosc

import sdm
from sdm.bench.disk.inputs import bent


def limits(folder: Path, *, megabytes: int = 256) -> dict[str, float]:
    """Megabytes a second of one thread, on a map of 128^3 voxels; of the disk, by one file that is flushed."""
    mesh = bent(20_000, 0)
    field = sdm.signed_distance_map((mesh.vertices, mesh.faces), resolution=128, device="cpu")
    plain = field.numpy().tobytes()
    codec = Blosc(cname="zstd", clevel=1, shuffle=SHUFFLE, blocksize=0)
    array = np.frombuffer(plain, np.float32)
    found = {
        "sha256": _rate(lambda: hashlib.sha256(plain).digest(), len(plain)),
        "crc32c": _rate(lambda: google_crc32c.value(plain), len(plain)),
        "blosc zstd 1": _rate(lambda: codec.encode(array), len(plain)),
        "isal gzip 1": _rate(lambda: isal_zlib.compress(plain, 1), len(plain)),
        "zlib gzip 1": _rate(lambda: gzip.compress(plain, 1), len(plain)),
    }
    return {**found, "disk": _disk(folder / "limit.bin", megabytes)}


def _rate(work: Callable[[], Any], size: int) -> float:
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return round(size / 1e6 / best, 1)


def _disk(path: Path, megabytes: int) -> float:
    block = os.urandom(1 << 20)
    start = time.perf_counter()
    with path.open("wb") as file:
        for _ in range(megabytes):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
    seconds = time.perf_counter() - start
    path.unlink()
    return round(megabytes * 2**20 / 1e6 / seconds, 1)
