"""Rows of libraries that make, or fill, bands on a GPU: each compared with a brute force first, then timed."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import once
from sdm.bench.peers import newton
from sdm.bench.peers.meshlib import MeshLibCuda, signed
from sdm.bench.peers.physicsnemo import PhysicsNeMo
from sdm.core.voxel_points import voxel_points


@dataclass(frozen=True)
class Asked:
    """A question to a library.

    Args:
        case: The mesh.
        device: A GPU.
        resolution: Voxels along the longest axis.
        half_width: Of the band, in voxels.
        points: (N,3) voxels that are compared.
        truth: Their distances and winding numbers.
        near: (M,3) indices of the voxels in our band, of which libraries that make no bands are told for nothing.
        runs: How often it is timed.
    """

    case: Case
    device: str
    resolution: int
    half_width: float
    points: torch.Tensor
    truth: tuple[np.ndarray, np.ndarray]
    near: torch.Tensor
    runs: int

    @property
    def grid(self) -> sdm.Grid:
        """The grid around the mesh."""
        return cube_around(self.case, self.resolution)

    @property
    def near_points(self) -> torch.Tensor:
        """Centres (M,3) of the voxels in the band."""
        return voxel_points(self.grid, self.near)


def physicsnemo_row(asked: Asked) -> dict[str, Any]:
    """PhysicsNeMo's row; it builds its tree in each call."""
    peer = PhysicsNeMo(asked.device)
    peer.build(asked.case)
    row = row_of(peer.name, asked.case, asked.resolution, len(asked.near), 4 * len(asked.near))
    found = peer.signed_distance(asked.points.to(asked.device))
    row |= errors(found.cpu().double().numpy(), asked.truth, asked.grid)
    points = asked.near_points
    seconds = [once(lambda: peer.signed_distance(points), asked.device)[0] / 1e3 for _ in range(1 + asked.runs)][1:]
    return row | _times(seconds)


def meshlib_row(asked: Asked) -> dict[str, Any]:
    """MeshLib's row, its mesh and trees built in each call; `query` is what the two searches of points alone take."""
    peer = MeshLibCuda(asked.device)
    peer.build(asked.case)
    row = row_of(peer.name, asked.case, asked.resolution, len(asked.near), 4 * len(asked.near))
    found = peer.signed_distance(asked.points)
    row |= errors(found.cpu().double().numpy(), asked.truth, asked.grid)
    points = peer.points_for(asked.near_points)

    def query() -> tuple[Any, Any]:
        return peer.distances_at(points), peer.winding_at(points)

    def whole() -> tuple[Any, Any]:
        peer.build(asked.case)
        return query()

    # Those of all voxels, too: what is timed is the same call.
    ours = sdm.signed_distance(fresh_mesh(asked), asked.near_points).cpu()
    wrong = [int(((signed(*found) < 0) != (ours < 0)).sum()) for found in (whole(), query())]
    row |= {"signs_in_band": wrong[0], "signs_of_a_repeated_query": wrong[1]}
    # Both end on the host, where their results are.
    seconds, alone = [], []
    for _ in range(1 + asked.runs):
        seconds.append(once(whole, "cpu")[0] / 1e3)
        alone.append(once(query, "cpu")[0] / 1e3)
    return row | _times(seconds[1:]) | {"query": statistics.median(alone[1:])}


def fresh_mesh(asked: Asked) -> sdm.TriangleMesh:
    """The mesh on the device."""
    return sdm.TriangleMesh(asked.case.vertices, asked.case.faces, asked.case.name, check=False).to(asked.device)


def newton_row(asked: Asked) -> dict[str, Any]:
    """Newton's row. At its own voxels, as it takes no grid; of its memory and processor time nothing is known."""
    case, grid = asked.case, asked.grid
    found = newton.sparse_field(case, grid, asked.half_width, asked.points.numpy(), asked.runs, asked.device)
    row = row_of(newton.NAME, case, asked.resolution, found.voxels, found.nbytes)
    brute = Brute(case.vertices, case.faces)
    truth = brute.distance(found.points)[0], brute.winding_number(found.points)
    return row | errors(found.values.astype(np.float64), truth, grid) | _times(found.seconds)


OTHERS = {"Newton": newton_row, "PhysicsNeMo": physicsnemo_row, "MeshLib": meshlib_row}


def notes(device: str) -> dict[str, str | None]:
    """Of each of `OTHERS` why it is left out, as a sentence; None if it is not."""
    on_a_gpu = device.startswith("cuda")
    found = {newton.NAME: newton.missing(device)}
    for name, peer in (("PhysicsNeMo", PhysicsNeMo(device)), ("MeshLib", MeshLibCuda(device))):
        alone = f"{name} is left out: at the voxels of a band it is asked on a GPU alone"
        found[name] = peer.missing() if on_a_gpu else alone
    return found


def _times(seconds: list[float]) -> dict[str, Any]:
    return {"peak": 0, "seconds": statistics.median(seconds), "cpu": 0.0, "all_seconds": seconds}


def row_of(library: str, case: Case, resolution: int, active: int, nbytes: int) -> dict[str, Any]:
    """The fields that all rows share."""
    return {
        "library": library,
        "mesh": case.name,
        "triangles": len(case),
        "resolution": resolution,
        "active_voxels": active,
        "bytes": nbytes,
    }


def near_voxels(band: sdm.SparseSDM) -> torch.Tensor:
    """Indices (N,3) of all voxels in the band."""
    place, x, y, z = (band.values.abs() < band.width).nonzero().unbind(1)
    return 8 * band.blocks[place].long() + torch.stack([x, y, z], 1)


def errors(values: np.ndarray, truth: tuple[np.ndarray, np.ndarray], grid: sdm.Grid) -> dict[str, Any]:
    """Largest and mean error in voxels, and signs that are wrong where winding numbers are clear."""
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
