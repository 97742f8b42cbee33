"""One mesh at one resolution: bands of both libraries, checked, then timed by turns."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Collection
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.band.peer_rows import OTHERS, Asked, errors, near_voxels, row_of
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import once
from sdm.bench.peers import openvdb
from sdm.core.voxel_points import voxel_points

OURS, PEER = "sdm", "OpenVDB"


def fresh(case: Case, device: str) -> sdm.TriangleMesh:
    """The mesh in new memory, of which nothing is remembered."""
    vertices, faces = torch.from_numpy(case.vertices.copy()), torch.from_numpy(case.faces.copy())
    return sdm.TriangleMesh(vertices.to(device), faces.to(device), case.name, check=False)


def measure(
    case: Case,
    device: str,
    resolution: int,
    half_width: float,
    samples: int,
    runs: int,
    *,
    with_peer: bool,
    others: Collection[str] = (),
) -> list[dict[str, Any]]:
    """The rows of the table: ours, and those of OpenVDB and of `others` (names of `OTHERS`)."""
    grid = cube_around(case, resolution)
    band = sdm.narrow_band(fresh(case, device), grid, half_width=half_width, device=device)
    voxels = _some_voxels(band, samples)
    truth = _truth(case, grid, voxels)
    rows = [row_of(OURS, case, resolution, band.active_voxels, band.nbytes)]
    rows[0] |= errors(band.at(voxels).cpu().double().numpy(), truth, grid)
    rows[0]["peak"] = _peak(case, device, resolution, half_width)
    times: dict[str, list[tuple[float, float]]] = {OURS: [], PEER: []}
    told = near_voxels(band) if others else None
    del band
    for _ in range(runs):
        mesh, begin = fresh(case, device), time.process_time()
        ms, _band = once(lambda mesh=mesh: sdm.narrow_band(mesh, grid, half_width=half_width, device=device), device)
        times[OURS].append((ms / 1e3, time.process_time() - begin))
        del _band
        if with_peer:
            # The first call of a process pays for what later ones have.
            found = openvdb.level_set(case, grid, half_width, voxels.numpy(), 2)
            times[PEER].append((found.seconds[-1], found.cpu_seconds[-1]))
    if with_peer:
        found = openvdb.level_set(case, grid, half_width, voxels.numpy(), 1)
        rows.append(row_of(PEER, case, resolution, found.active_voxels, found.nbytes))
        rows[1] |= errors(found.values.astype(np.float64), truth, grid)
        rows[1]["peak"] = found.peak_bytes
    for row in rows:
        wall, cpu = zip(*times[row["library"]], strict=True)
        row |= {"seconds": statistics.median(wall), "cpu": statistics.median(cpu), "all_seconds": list(wall)}
    if told is not None:
        asked = Asked(case, device, resolution, half_width, voxel_points(grid, voxels), truth, told, runs)
        rows += [OTHERS[name](asked) for name in OTHERS if name in others]
    return rows


def _some_voxels(band: sdm.SparseSDM, count: int) -> torch.Tensor:
    """Indices (N,3) of voxels in the band, by chance."""
    rng = np.random.default_rng(0)
    blocks = band.blocks[torch.from_numpy(rng.integers(0, len(band), 8 * count)).to(band.device)].cpu()
    voxels = blocks.long() * 8 + torch.from_numpy(rng.integers(0, 8, (8 * count, 3)))
    voxels = voxels[(voxels < torch.tensor(band.shape, device="cpu")).all(1)]
    near = band.at(voxels).abs().cpu() < band.width
    return voxels[near][:count]


def _truth(case: Case, grid: sdm.Grid, voxels: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Distances and winding numbers at voxels, in float64."""
    brute, points = Brute(case.vertices, case.faces), voxel_points(grid, voxels).numpy()
    return brute.distance(points)[0], brute.winding_number(points)


def _peak(case: Case, device: str, resolution: int, half_width: float) -> int:
    """Bytes that one band takes more than what was there before it: of a process of its own, or of the GPU."""
    if device.startswith("cuda"):
        mesh, grid = fresh(case, device), cube_around(case, resolution)
        torch.cuda.synchronize()
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        sdm.narrow_band(mesh, grid, half_width=half_width, device=device)
        return torch.cuda.max_memory_allocated() - before
    words = [sys.executable, "-m", "sdm.bench.band.peak_memory", case.name, str(resolution), str(half_width)]
    return int(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
