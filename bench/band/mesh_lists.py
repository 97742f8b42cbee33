"""Bands of lists of meshes that differ: in one call, and mesh by mesh.

    python -m sdm.bench.band.mesh_lists --device cuda --out band-lists-cuda.json

`--meshes` tori of about `--triangles` triangles, each of another number and in new memory each time, on grids of
their own, by turns. Before that each band of the list is compared with that of its own call, bit for bit.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path
from typing import Any

import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import torus
from sdm.bench.common.timing import once


def fresh(count: int, triangles: int, device: str) -> list[sdm.TriangleMesh]:
    """Meshes in new memory, of which nothing is remembered."""
    found = []
    for number in range(count):
        vertices, faces = torus(int(triangles * (1 + number / count / 4)))
        found.append(sdm.TriangleMesh(vertices, faces, f"torus {number}", check=False).to(device))
    return found


def measure(count: int, triangles: int, resolution: int, device: str, runs: int) -> dict[str, Any]:
    """A row: seconds of the list, and of its meshes one by one."""
    meshes = fresh(count, triangles, device)
    grids = [sdm.Grid.around(mesh, resolution) for mesh in meshes]

    def together(some: list[sdm.TriangleMesh]) -> list[sdm.SparseSDM]:
        return sdm.narrow_band(some, grids, device=device)

    def alone(some: list[sdm.TriangleMesh]) -> list[sdm.SparseSDM]:
        return [sdm.narrow_band(mesh, grid, device=device) for mesh, grid in zip(some, grids, strict=True)]

    pairs = zip(together(meshes), alone(fresh(count, triangles, device)), strict=True)
    same = all(torch.equal(getattr(a, k), getattr(b, k)) for a, b in pairs for k in ("blocks", "values", "inside"))
    times: dict[str, list[float]] = {"together": [], "alone": []}
    for _ in range(runs):
        for name, call in (("together", together), ("alone", alone)):
            some = fresh(count, triangles, device)
            times[name].append(once(lambda call=call, some=some: call(some), device)[0] / 1e3)
    row: dict[str, Any] = {"meshes": count, "triangles": triangles, "resolution": resolution, "same_bits": same}
    return row | {name: statistics.median(found) for name, found in times.items()} | {"all_seconds": times}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--meshes", type=int, default=64)
    parser.add_argument("--triangles", type=int, default=20_000)
    parser.add_argument("--resolutions", type=int, nargs="*", default=[128, 256, 512])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--out", type=Path, help="a JSON file")
    given = parser.parse_args()
    rows = []
    for resolution in given.resolutions:
        row = measure(given.meshes, given.triangles, resolution, given.device, given.runs)
        rows.append(row)
        each = [1e3 * row[name] / given.meshes for name in ("together", "alone")]
        bits = "same bits" if row["same_bits"] else "OTHER BITS"
        print(f"{resolution:>5}^3: {each[0]:.3f} ms a mesh in a list, {each[1]:.3f} one by one, {bits}", flush=True)
        if given.out:
            json_file.write(given.out, {"machine": describe(given.device), "runs": given.runs, "rows": rows})


if __name__ == "__main__":
    main()
