"""From disk to disk: how fast are reading, `sdm compute`, `sdm generate` and `sdm sample`, and what limits them?

    python -m sdm.bench.disk --device cuda --folder /dev/shm

Each pipeline's rate stands beside that of the engine alone on the same meshes, and beside what one thread does of
checksums and compression, and the disk, which is that of `--folder`. Busy seconds are summed over a stage's threads.
The maps of the first mesh and of the last are compared with single calls before anything is written down.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.machine import describe
from sdm.bench.disk.limits import limits
from sdm.bench.disk.pipelines import Sizes, compute_rows, generate_rows, sample_row
from sdm.bench.disk.readers import readers
from sdm.bench.disk.timeline import draw

SMALL = Sizes(meshes=24, triangles=20_000, resolution=128, maps=192, points=100_000)
LARGE = Sizes(meshes=1000, triangles=20_000, resolution=128, maps=20_000, points=500_000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument(
        "--folder", type=Path, help="a place on the disk that counts; by default that of temporary files"
    )
    parser.add_argument("--parts", nargs="*", default=["readers", "limits", "compute", "generate", "sample"])
    parser.add_argument("--meshes", type=int)
    parser.add_argument("--maps", type=int)
    parser.add_argument("--points", type=int)
    parser.add_argument("--threads", type=int, help="of reading, and as many of writing, in sdm compute")
    parser.add_argument("--out", type=Path, help="JSON file; the picture lies beside it")
    options = parser.parse_args()
    # The engine has threads of its own; those of torch wait for each other by spinning, which a CPU's clock counts.
    torch.set_num_threads(1)
    plain = LARGE if options.device != "cpu" else SMALL
    sizes = Sizes(
        meshes=options.meshes or plain.meshes,
        triangles=plain.triangles,
        resolution=plain.resolution,
        maps=options.maps or plain.maps,
        points=options.points or plain.points,
        threads=options.threads,
    )
    out = options.out or results_folder() / f"disk-{options.device.partition(':')[0]}.json"
    record: dict[str, Any] = {"machine": describe(options.device), "cores": len(os.sched_getaffinity(0))}
    record["load"] = os.getloadavg()[0]
    folder = Path(tempfile.mkdtemp(prefix="sdm-disk-", dir=options.folder))
    try:
        measure(options.parts, folder, sizes, options.device, out, record)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    json_file.write(out, record)
    print(out)


def measure(parts: list[str], folder: Path, sizes: Sizes, device: str, out: Path, record: dict[str, Any]) -> None:
    """Fill the record by the parts, and draw the picture."""
    if "readers" in parts:
        record["readers"] = [row for size in (20_000, 320_000) for row in readers(folder, size, runs=3)]
        for row in record["readers"]:
            print(" ".join(f"{key} {value}" for key, value in row.items()))
    if "limits" in parts:
        record["limits_mb_per_s"] = limits(folder)
        print(record["limits_mb_per_s"])
    rows: list[dict[str, Any]] = record.setdefault("pipelines", [])
    if "compute" in parts:
        found, times = compute_rows(folder, sizes, device)
        rows += found
        json_file.write(out, record)
        check(folder, sizes, device)
        draw(times, out.with_suffix(".png"), f"sdm compute, {sizes.meshes} meshes to .npz, {device}")
    if "generate" in parts:
        rows += generate_rows(folder, sizes, device)
        # What is measured is kept, should the rest be cut off.
        json_file.write(out, record)
    if "sample" in parts:
        rows.append(sample_row(folder, sizes, device))
    for row in rows:
        print(" ".join(f"{key} {value}" for key, value in row.items()))


def check(folder: Path, sizes: Sizes, device: str) -> None:
    """Compare the maps of the first mesh and the last with single calls."""
    files = sorted((folder / "meshes").glob("*.ply"))
    for file in (files[0], files[-1]):
        expected = sdm.signed_distance_map(file, resolution=sizes.resolution, device=device).numpy()
        for ending in ("npz", "nii.gz"):
            found = sdm.load(folder / f"maps-{ending}" / f"{file.stem}.{ending}").numpy()
            if not np.array_equal(found, expected):
                raise SystemExit(f"the map of {file.name} as .{ending} is not that of a single call")


if __name__ == "__main__":
    main()
