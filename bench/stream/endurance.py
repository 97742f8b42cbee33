"""Memory over thousands of different meshes in one process: `python -m sdm.bench.stream.endurance --help`."""

from __future__ import annotations

import argparse
import gc
import sys
import time
from pathlib import Path

import numpy as np
import torch

import sdm
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import sphere

# Samples of memory, evenly over the run; the first is taken after a tenth of it, when caches are full.
SAMPLES = 10


def one(seed: int, device: str) -> None:
    """A mesh of its own size and shape: closed or open, and every kind of query."""
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(4 + seed % 13)
    moved = torch.tensor(vertices + 0.05 * rng.normal(size=vertices.shape), dtype=torch.float32, requires_grad=True)
    index = sdm.MeshIndex(sdm.TriangleMesh(moved, faces[seed % 3 :]), device)
    points = torch.from_numpy(rng.normal(size=(int(rng.choice([10, 500, 5000])), 3)).astype(np.float32))
    index.signed_distance(points).sum().backward()
    index.signed_distance_map(sdm.Grid([-1.2] * 3, [2.4 / 23] * 3, rng.integers(1, 25, 3)))
    index.update(2 * vertices)
    index.winding_number(points[:10])


def memory(device: str) -> dict[str, int]:
    """Bytes in use: of the process, and of torch and of everybody on the device."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    found = {"resident": 4096 * pages}
    if device.startswith("cuda"):
        torch.cuda.synchronize()
        free, total = torch.cuda.mem_get_info()
        found |= {"allocated": torch.cuda.memory_allocated(), "device": total - free}
    return found


def main() -> int:
    parser = argparse.ArgumentParser(
        "python -m sdm.bench.stream.endurance", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="cpu or cuda")
    parser.add_argument("--meshes", type=int, default=20_000, help="how many")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    options = parser.parse_args()
    begin = time.perf_counter()
    samples = []
    for seed in range(options.meshes):
        one(seed, options.device)
        if (seed + 1) % max(1, options.meshes // SAMPLES) == 0:
            samples.append({"meshes": seed + 1, **memory(options.device)})
            print(*(f"{k} {v:,}" for k, v in samples[-1].items()), sep="  ", flush=True)
    grown = {k: samples[-1][k] - samples[0][k] for k in samples[0] if k != "meshes"}
    report = {**describe(options.device), "seconds": round(time.perf_counter() - begin, 1), "grown": grown}
    print("grown since the first sample:", grown)
    if options.out:
        write(options.out, {**report, "samples": samples})
    return 0


if __name__ == "__main__":
    sys.exit(main())
