"""The host's share of `sdm generate`: writing shards of maps that are there already, by threads.

    python -m sdm.bench.disk.host_shards --out results/disk-shards-cpu.json

What a GPU leaves to the host once maps are in its memory: checksums, SHA-256, compression and the file. Milliseconds
are of the processor, for one map, the least of the rounds.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.dataset.shard_paths import file_of
from sdm.dataset.shard_writer import write_shard
from sdm.dataset.writer import generate
from sdm.shapes import Cochlea


@dataclass(frozen=True)
class Options:
    """Shards of a cochlea's maps, again and again.

    Args:
        maps: In each shard.
        shards: Written in each round.
        resolution: Voxels along each axis.
        threads: That write shards, of the runs.
        compressors: Threads that compress for all of them.
        rounds: How often everything is done.
        folder: Where to write; a temporary one by default.
        out: JSON file.
    """

    maps: int = 128
    shards: int = 4
    resolution: int = 64
    threads: tuple[int, ...] = (1, 2)
    compressors: int = 2
    rounds: int = 5
    folder: Path | None = None
    out: Path | None = None


def rows(options: Options) -> list[dict[str, Any]]:
    """A row for each type and number of threads."""
    family, found = Cochlea(20_000), []
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        for dtype, compression in ((torch.float16, "none"), (torch.float32, "zstd")):
            out = Path(folder) / f"{compression}.zarr"
            grid = family.grid(options.resolution)
            # A few real maps, whose bytes compress as maps do.
            generate(family, grid, 4, out, dtype=dtype, compression=compression, device="cpu")
            job = _job(out, options)
            few = _maps(out)
            maps = np.ascontiguousarray(np.resize(few, (options.maps, *few.shape[1:])))
            for threads in options.threads:
                measured = [_round(out, job, maps, threads, options) for _ in range(options.rounds)]
                name = f"{str(dtype).removeprefix('torch.')} {compression}"
                row = {key: round(min(one[key] for one in measured), 3) for key in ("cpu_ms", "ms", "mb_each")}
                found.append({"maps": name, "threads": threads, **row, "per_second": round(1e3 / row["ms"], 1)})
    return found


def _job(out: Path, options: Options) -> dict[str, Any]:
    from sdm.dataset.manifest import read_manifest

    count = options.maps * options.shards
    return {**read_manifest(out), "count": count, "shard": options.maps}


def _maps(out: Path) -> np.ndarray:
    import zarr

    found: Any = zarr.open_array(out / "sdm", mode="r")
    return found[:]


def _round(out: Path, manifest: dict[str, Any], maps: np.ndarray, threads: int, options: Options) -> dict[str, float]:
    theta = np.zeros((len(maps), len(manifest["parameters"])), np.float32)
    scratch = out.with_suffix(".part")
    scratch.mkdir()
    start, cpu = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(options.compressors) as pool, ThreadPoolExecutor(threads) as writers:
        work = [
            writers.submit(write_shard, out, manifest, number, theta, None, maps, scratch, pool)
            for number in range(options.shards)
        ]
        for one in work:
            one.result()
    count = len(maps) * options.shards
    spent = {"ms": 1e3 * (time.perf_counter() - start) / count, "cpu_ms": 1e3 * (time.process_time() - cpu) / count}
    files = (file_of(out, "sdm", number) for number in range(options.shards))
    spent["mb_each"] = sum(file.stat().st_size for file in files) / 1e6 / count
    shutil.rmtree(scratch)
    return spent


def main() -> None:
    """Print a row for each run, and write the record."""
    options = tyro.cli(Options, description=__doc__)
    record: dict[str, Any] = {"machine": describe("cpu"), "load": os.getloadavg()[0], "maps": options.maps}
    record |= {"shards": options.shards, "resolution": options.resolution, "rows": rows(options)}
    for row in record["rows"]:
        sys.stdout.write(" ".join(f"{key} {value}" for key, value in row.items()) + "\n")
    if options.out is not None:
        json_file.write(options.out, record)


if __name__ == "__main__":
    main()
