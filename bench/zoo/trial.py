"""One file of a folder: read, looked over, measured, checked and timed, or refused in one sentence."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import query_points as sampling
from sdm.bench.common.correctness import compare, voxel_centres
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import Case, torus
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import once
from sdm.bench.zoo.folder import Found, as_case
from sdm.bench.zoo.speed import builders, new_mesh, stock_ms, wake
from sdm.errors import SDMError, SDMWarning

# Calls after the first, of which the fastest counts.
REPEATED = 3


def trial(found: Found, device: str, resolution: int, points: int) -> dict[str, Any]:
    """All there is to say about a file; an exception that is no user's to mend is told under `broken`."""
    row: dict[str, Any] = {"mesh": found.name}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            mesh = found.load()
            row |= _look(mesh)
            row |= _measure(as_case(mesh, found.name), device, resolution, points)
        except SDMError as error:
            row["refused"] = str(error)
        except Exception as error:  # noqa: BLE001 - whatever else comes out is a finding
            row["broken"] = f"{type(error).__name__}: {error}"
    row["warnings"] = [str(w.message) for w in said if issubclass(w.category, SDMWarning)]
    stray = [f"{w.category.__name__}: {w.message}" for w in said if not issubclass(w.category, SDMWarning)]
    if stray:
        row["stray_warnings"] = stray
    return row


def _look(mesh: sdm.TriangleMesh) -> dict[str, Any]:
    report = sdm.inspect_mesh(mesh)
    # Of reports that recommend one.
    advised = getattr(report, "recommended_sign", None)
    return ({} if advised is None else {"recommended_sign": advised}) | {
        "triangles": report.triangles,
        "vertices": report.vertices,
        "components": report.components,
        "closed": report.closed,
        "oriented": report.oriented,
        "outward": report.outward,
        "boundary_edges": report.boundary_edges,
        "degenerate_faces": report.degenerate_faces,
        "duplicate_faces": report.duplicate_faces,
        "problems": report.problems,
    }


@cache
def _warm_up(device: str, resolution: int) -> None:
    """Load the kernels, which is no file's fault."""
    vertices, faces = torus(500)
    for some in (faces, faces[::2]):
        case = Case("warm", vertices, some, frozenset())
        sdm.signed_distance_map(new_mesh(case, device, 0), cube_around(case, resolution), device=device).numpy()


def _measure(case: Case, device: str, resolution: int, points: int) -> dict[str, Any]:
    _warm_up(device, resolution)
    grid = cube_around(case, resolution)
    mesh = new_mesh(case, device, 0)
    wake(device)
    first, field = once(lambda: sdm.signed_distance_map(mesh, grid, device=device), device)
    values = field.numpy()
    repeated = [once(lambda: sdm.signed_distance_map(mesh, grid, device=device), device)[0] for _ in range(REPEATED)]
    brute = Brute(case.vertices, case.faces, device)
    at = np.concatenate([sampling.uniform(case, points - points // 2), sampling.near(case, points // 2)])
    scattered = sdm.signed_distance(mesh, torch.from_numpy(at).to(device)).cpu().numpy()
    which = np.random.default_rng(0).integers(0, grid.size, points)
    asked = np.concatenate([at, voxel_centres(grid, which)])
    answers = np.concatenate([scattered, values.reshape(-1)[which]])
    tally = compare(case, asked, answers, brute.distance(asked)[0], brute.winding_number(asked))
    stock = min(stock_ms(peer, case, grid, device) for peer in builders(device))
    return {
        "sign": field.sign,
        "ambiguous_voxels": field.ambiguous_voxels,
        "inside_voxels": int((values < 0).sum()),
        "first_ms": first,
        "repeated_ms": min(repeated),
        "stock_ms": stock,
        "checked": tally.as_dict(),
    }
