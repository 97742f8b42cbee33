"""Samples a second from a dataset on disk, shuffled, against the stream."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

from torch.utils.data import DataLoader

from sdm.bench.stream.sizes import Bench
from sdm.dataset import SDMDataset, generate
from sdm.dataset.manifest import COMPRESSIONS

# Samples of the dataset, those of a shard, and the most workers that read.
COUNT, SHARD, WORKERS = 1024, 128, 8


def reading(bench: Bench) -> dict[str, Any]:
    """Written and read a second, for each compression; what was just written is still in the system's memory."""
    count = COUNT if bench.gpu else 24
    workers = min(WORKERS, len(os.sched_getaffinity(0)))
    result: dict[str, Any] = {"samples": count, "workers": workers, "batch": bench.batch}
    with tempfile.TemporaryDirectory() as folder:
        for compression in COMPRESSIONS:
            start = time.perf_counter()
            path = generate(
                bench.family,
                bench.grid,
                count,
                Path(folder) / f"{compression}.zarr",
                device=bench.device,
                compression=compression,
                shard=SHARD if bench.gpu else 4,
            )
            written = count / (time.perf_counter() - start)
            size = sum(f.stat().st_size for f in path.rglob("*") if f.is_file()) / count / 2**20
            rates = {"written_per_second": written, "mib_per_sample": size, **read(bench, SDMDataset(path), workers)}
            result[compression] = rates
    result["streamed_per_second"] = bench.rate(iter(bench.stream(bench.batch)), bench.batch)
    return result


def read(bench: Bench, data: SDMDataset, workers: int) -> dict[str, float]:
    """Samples a second of one process that asks for them one by one, and of a DataLoader with workers."""
    order = [(7 * i) % len(data) for i in range(min(len(data), 256))]
    start = time.perf_counter()
    for number in order:
        data[number]
    alone = len(order) / (time.perf_counter() - start)
    feed = DataLoader(
        data,
        bench.batch,
        shuffle=True,
        num_workers=workers,
        persistent_workers=True,
        multiprocessing_context="spawn",
    )
    # The first pass starts the workers, which is not what is measured.
    for _ in feed:
        pass
    start, found = time.perf_counter(), 0
    for batch in feed:
        found += len(batch.index)
    return {"read_per_second": found / (time.perf_counter() - start), "read_per_second_by_one_process": alone}
