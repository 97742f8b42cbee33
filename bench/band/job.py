"""One mesh at one resolution: bands of both libraries, checked, then timed by turns."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import once
from sdm.bench.peers import newton, openvdb
from sdm.bench.peers.physicsnemo import PhysicsNeMo
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
    with_newton: bool = False,
    with_physicsnemo: bool = False,
) -> list[dict[str, Any]]:
    """The rows of the table: ours, and those of the others that are there."""
    grid = cube_around(case, resolution)
    band = sdm.narrow_band(fresh(case, device), grid, half_width=half_width, device=device)
    voxels = _some_voxels(band, samples)
    truth = _truth(case, grid, voxels)
    rows = [_row(OURS, case, resolution, band.active_voxels, band.nbytes)]
    rows[0] |= _errors(band.at(voxels).cpu().double().numpy(), truth, grid)
    rows[0]["peak"] = _peak(case, device, resolution, half_width)
    times: dict[str, list[tuple[float, float]]] = {OURS: [], PEER: []}
    near = _near_voxels(band) if with_physicsnemo else None
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
        rows.append(_row(PEER, case, resolution, found.active_voxels, found.nbytes))
        rows[1] |= _errors(found.values.astype(np.float64), truth, grid)
        rows[1]["peak"] = found.peak_bytes
    for row in rows:
        wall, cpu = zip(*times[row["library"]], strict=True)
        row |= {"seconds": statistics.median(wall), "cpu": statistics.median(cpu), "all_seconds": list(wall)}
    if with_newton:
        rows.append(_newton_row(case, device, resolution, half_width, voxel_points(grid, voxels).numpy(), runs))
    if near is not None:
        rows.append(_physicsnemo_row(case, device, resolution, voxel_points(grid, voxels), truth, near, runs))
    return rows


def _physicsnemo_row(
    case: Case,
    device: str,
    resolution: int,
    some: torch.Tensor,
    truth: tuple[np.ndarray, np.ndarray],
    near: torch.Tensor,
    runs: int,
) -> dict[str, Any]:
    """PhysicsNeMo's row: it makes no bands, so it is told which voxels (N,3) are in ours, for nothing."""
    peer, grid = PhysicsNeMo(device), cube_around(case, resolution)
    peer.build(case)
    row = _row(peer.name, case, resolution, len(near), 4 * len(near))
    row |= _errors(peer.signed_distance(some.to(device)).cpu().double().numpy(), truth, grid)
    points = voxel_points(grid, near)
    seconds = [once(lambda: peer.signed_distance(points), device)[0] / 1e3 for _ in range(1 + runs)][1:]
    return row | {"peak": 0, "seconds": statistics.median(seconds), "cpu": 0.0, "all_seconds": seconds}


def _newton_row(
    case: Case, device: str, resolution: int, half_width: float, points: np.ndarray, runs: int
) -> dict[str, Any]:
    """Newton's row. At its own voxels, as it takes no grid; of its memory and processor time nothing is known."""
    grid = cube_around(case, resolution)
    found = newton.sparse_field(case, grid, half_width, points, runs, device)
    row = _row(newton.NAME, case, resolution, found.voxels, found.nbytes)
    brute = Brute(case.vertices, case.faces)
    truth = brute.distance(found.points)[0], brute.winding_number(found.points)
    row |= _errors(found.values.astype(np.float64), truth, grid)
    row |= {"peak": 0, "seconds": statistics.median(found.seconds), "cpu": 0.0, "all_seconds": found.seconds}
    return row


def _row(library: str, case: Case, resolution: int, active: int, nbytes: int) -> dict[str, Any]:
    return {
        "library": library,
        "mesh": case.name,
        "triangles": len(case),
        "resolution": resolution,
        "active_voxels": active,
        "bytes": nbytes,
    }


def _near_voxels(band: sdm.SparseSDM) -> torch.Tensor:
    """Indices (N,3) of all voxels in the band."""
    place, x, y, z = (band.values.abs() < band.width).nonzero().unbind(1)
    return 8 * band.blocks[place].long() + torch.stack([x, y, z], 1)


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


def _errors(values: np.ndarray, truth: tuple[np.ndarray, np.ndarray], grid: sdm.Grid) -> dict[str, Any]:
    distance, winding = truth
    clear = np.abs(winding - 0.5) > 1e-3
    wrong = ((values < 0) != (winding > 0.5)) & clear & (distance > 1e-6 * grid.spacing[0])
    error = np.abs(np.abs(values) - distance) / grid.spacing[0]
    return {
        "error": float(error.max()),
        "mean_error": float(error.mean()),
        "signs": int(wrong.sum()),
        "samples": len(values),
    }


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
