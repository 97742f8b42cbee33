"""Two processor cores: what share of the engine's speed has `sdm generate`? In pairs, one after the other.

    python -m sdm.bench.disk.pairs

Each pair is the engine alone, which makes the maps and keeps none, and the command, which writes the same; by turns the
one or the other is first. Ratios are of each pair, so that what others do on the machine falls on both; the record
has all of them, by the clock and by processor time.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common import json_file
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.machine import describe
from sdm.bench.disk.devices import MAPS_AT, TRIANGLES
from sdm.bench.disk.pipelines import alone_of_generate, quietly
from sdm.dataset import generate
from sdm.shapes import Cochlea

WAYS = ((torch.float16, "none"), (torch.float32, "zstd"))


def row_of(folder: Path, maps: int, pairs: int, dtype: torch.dtype, compression: str) -> dict[str, Any]:
    """Pairs of one format."""
    family = Cochlea(TRIANGLES)
    grid = family.grid(MAPS_AT)
    alone: list[tuple[float, float]] = []
    ours: list[tuple[float, float]] = []

    def write() -> None:
        out = folder / "d.zarr"
        more: dict[str, Any] = {"dtype": dtype, "compression": compression, "device": "cpu"}
        ours.append(quietly(lambda: generate(family, grid, maps, out, **more)))
        shutil.rmtree(out)

    for number in range(pairs):
        if number % 2:
            write()
        alone.append(alone_of_generate(family, grid, maps, "cpu"))
        if not number % 2:
            write()
    by_clock, by_cpu = (
        sorted(one[kind] / other[kind] for one, other in zip(alone, ours, strict=True)) for kind in (0, 1)
    )
    return {
        "work": f"generate {str(dtype).removeprefix('torch.')} {compression}",
        "maps": maps,
        "pairs": pairs,
        "of_engine": round(statistics.median(by_clock), 3),
        "of_engine_all": [round(one, 3) for one in by_clock],
        "of_engine_cpu": round(statistics.median(by_cpu), 3),
        "of_engine_cpu_all": [round(one, 3) for one in by_cpu],
        "per_second": round(maps / statistics.median(one[0] for one in ours), 3),
        "engine_alone_per_second": round(maps / statistics.median(one[0] for one in alone), 3),
    }


def main() -> None:
    """Measure, and write the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", type=int, default=24)
    parser.add_argument("--pairs", type=int, default=9)
    parser.add_argument("--folder", type=Path, help="a place on the disk that counts")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    # The engine has threads of its own.
    torch.set_num_threads(1)
    record: dict[str, Any] = {"machine": describe("cpu"), "cores": len(os.sched_getaffinity(0))}
    record |= {"load": os.getloadavg()[0], "pipelines": []}
    out = options.out or results_folder() / "disk-pairs-cpu.json"
    with tempfile.TemporaryDirectory(prefix="sdm-disk-", dir=options.folder) as folder:
        for way in WAYS:
            record["pipelines"].append(row_of(Path(folder), options.maps, options.pairs, *way))
            print(record["pipelines"][-1], flush=True)
            json_file.write(out, record)
    print(out)


if __name__ == "__main__":
    main()
