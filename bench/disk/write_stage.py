"""The write stage of `sdm compute` alone, by threads: processor time, and how often a thread waits, for each map.

Run it as `python -m sdm.bench.disk.write_stage`. A thread that gives up Python's lock has to wait for the others to
have it back, so a wait costs more the more threads there are; the counts do not depend on what else the machine does.
"""

from __future__ import annotations

import json
import resource
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.io.maps.api import save_made_from


@dataclass(frozen=True)
class Options:
    """Maps written by threads.

    Args:
        maps: Written in each run.
        resolution: Voxels along each axis.
        threads: Of the runs.
        folder: Where to write; a temporary one by default.
    """

    maps: int = 60
    resolution: int = 128
    threads: tuple[int, ...] = (1, 15)
    folder: Path | None = None


def write_rows(options: Options) -> list[dict[str, Any]]:
    """A row for each format and number of threads; milliseconds and counts are those of one map."""
    count = options.resolution
    grid = Grid((0.0,) * 3, (1 / count,) * 3, (count,) * 3)
    axis = torch.linspace(-1, 1, count, device="cpu")
    values = (axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2).sqrt() - 0.7
    rows = []
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        for ending in ("npz", "nii.gz"):

            def write(number: int, ending: str = ending) -> float:
                start = time.perf_counter()
                field = SDM(values, grid, 0)
                save_made_from(field, Path(folder) / f"{number}.{ending}", None)
                _ = field.inside_voxels
                return time.perf_counter() - start

            write(0)
            for threads in options.threads:
                before = resource.getrusage(resource.RUSAGE_SELF)
                with ThreadPoolExecutor(threads) as pool:
                    busy = sum(pool.map(write, range(options.maps)))
                after = resource.getrusage(resource.RUSAGE_SELF)
                each = {
                    "user_ms": 1e3 * (after.ru_utime - before.ru_utime),
                    "system_ms": 1e3 * (after.ru_stime - before.ru_stime),
                    "busy_ms": 1e3 * busy,
                    "waits": after.ru_nvcsw - before.ru_nvcsw,
                }
                named = {name: round(value / options.maps, 2) for name, value in each.items()}
                rows.append({"format": ending, "threads": threads, **named})
    return rows


def main() -> None:
    """Print a row of JSON for each run."""
    for row in write_rows(tyro.cli(Options)):
        sys.stdout.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
