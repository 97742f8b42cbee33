"""Writer of a shard's files. It imports little, so that processes that only write start quickly."""

from __future__ import annotations

import hashlib
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from sdm.dataset.shard_file import maps_content, rows_content
from sdm.dataset.shard_paths import arrays_of, checksum_file, files_of
from sdm.io.files.atomic import put
from sdm.io.files.direct_file import DirectFile

# Of each array of rows.
DTYPES = {"theta": "float32", "transform": "float64"}


def write_shard(
    folder: Path,
    manifest: dict[str, Any],
    number: int,
    theta: np.ndarray,
    transform: np.ndarray | None,
    maps: np.ndarray,
    scratch: Path,
    pool: Executor,
) -> None:
    """Write a shard: each file whole or not at all, its checksum last.

    Args:
        folder: The dataset.
        manifest: Its manifest.
        number: Which shard.
        theta: (n,P) parameters.
        transform: (n,4,4), for families that place meshes.
        maps: (n,nx,ny,nz) in the dataset's type.
        scratch: A folder on the same disk that nobody else uses.
        pool: Threads that compress.
    """
    files = dict(zip(arrays_of(manifest), files_of(folder, manifest, number), strict=True))
    rows = {"theta": theta} if transform is None else {"theta": theta, "transform": transform}
    digest = hashlib.sha256()
    for name, values in rows.items():
        content = rows_content(values, manifest, DTYPES[name])
        digest.update(content)
        put(files[name], content)
    # Under another name until it is whole; its file then takes its place in the dataset.
    part = scratch / str(number)
    with DirectFile(part, maps.nbytes) as file:
        for pieces in maps_content(maps, manifest, pool):
            for piece in pieces:
                digest.update(piece)
            file.write_all(pieces)
    put(files["sdm"], part)
    put(checksum_file(folder, number), digest.digest())


def write_alone(
    folder: Path,
    manifest: dict[str, Any],
    number: int,
    theta: np.ndarray,
    transform: np.ndarray | None,
    maps: np.ndarray,
    scratch: Path,
    threads: int,
) -> None:
    """Write a shard in a process that does nothing else, with so many threads that compress; see `write_shard`."""
    write_shard(folder, manifest, number, theta, transform, maps, scratch, _pool(threads))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="sdm-compress")
