"""Part `closest`: what closest points cost, as the time of a map with them over that of the map alone.

Both are queries of a structure that is there; on a GPU both are replayed as CUDA graphs, and `calls` is the same of
`MeshIndex.signed_distance_map` as it is called, for repeated calls. The values must be the same, the closest point at
the distance that they tell, and its face as near as the one that scattered points get.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common.correctness import rounding
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import by_turns
from sdm.bench.dense.job import Job, Ours, geometric_mean, recorded
from sdm.engine.map_closest import COMPARED, closest_map
from sdm.engine.ops import map_slab
from sdm.runtime import graphs

MESHES = ("rocker-arm", "nefertiti", "fandisk", "stanford-bunny")
SMALL = ("torus-2000",)
RESOLUTIONS = {True: (64, 128, 256), False: (64, 128)}
# Voxels that are checked; largest error of a closest point, in roundings.
CHECKED, LIMIT = 2000, 6.0


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each mesh and grid."""
    for case in job.cases(SMALL if job.quick else MESHES):
        ours = Ours(case, job.device)
        for resolution in (16,) if job.quick else RESOLUTIONS[job.gpu]:
            if not job.has_time(f"{case.name} at {resolution}^3"):
                continue
            graphs.clear()
            yield {"mesh": case.name, "triangles": len(case), "resolution": resolution} | _row(
                job, case, ours, cube_around(case, resolution)
            )


def _row(job: Job, case: Case, ours: Ours, grid: sdm.Grid) -> dict[str, Any]:
    index = ours.index
    mesh = sdm.TriangleMesh(ours.vertices, ours.faces, case.name, check=False)

    def alone() -> torch.Tensor:
        return map_slab(ours.vertices[None], ours.faces, index._structure, grid, 0, grid.shape[0])[0]

    def both() -> torch.Tensor:
        return closest_map(mesh, index._structure, grid).values

    calls = {
        "called_alone": lambda: index.signed_distance_map(grid),
        "called_both": lambda: index.signed_distance_map(grid, return_closest=True),
    }
    for _ in range(graphs.CALLS):
        for call in calls.values():
            call()
    # A call that compares its values with the map's waits for the device, which no recording can.
    apart = job.gpu and not COMPARED["cuda"]
    queries = {"alone": recorded(alone)[0], "both": recorded(both)[0]} if apart else {}
    times = by_turns(calls | queries, job.device, job.runs, 3000.0)
    found: dict[str, Any] = {f"{name}_ms": timing.ms for name, timing in times.items()}
    found["ratio_called"] = found["called_both_ms"] / found["called_alone_ms"]
    found["ratio"] = found["both_ms"] / found["alone_ms"] if apart else found["ratio_called"]
    return found | _checked(case, index, grid, job.device)


def _checked(case: Case, index: sdm.MeshIndex, grid: sdm.Grid, device: str) -> dict[str, Any]:
    field, hit = index.signed_distance_map(grid, return_closest=True)
    same = torch.equal(field.values, index.signed_distance_map(grid).values)
    which = np.random.default_rng(0).integers(0, grid.size, CHECKED)
    at = grid.points().reshape(-1, 3)[which]
    some = torch.from_numpy(which).to(hit.faces.device)
    points, faces = hit.points.reshape(-1, 3)[some], hit.faces.reshape(-1)[some].cpu().numpy()
    reach = (points.cpu().double() - at.double()).norm(dim=1).numpy()
    brute = Brute(case.vertices, case.faces, device)
    nearest = brute.distance(at.numpy())[0]
    unit = rounding(case, at.numpy())
    errors = {
        "reach": np.abs(reach - nearest) / unit,
        "value": np.abs(reach - field.values.reshape(-1)[some].abs().cpu().numpy()) / unit,
        "face": np.abs(brute.distance_to_face(at.numpy(), faces) - nearest) / unit,
    }
    _, by_points = index.signed_distance(at.to(hit.points.device), return_closest=True)
    worst = {name: float(error.max()) for name, error in errors.items()}
    return {
        "same_values": same,
        "errors": worst,
        "faces_as_points": float((by_points.faces.cpu().numpy() == faces).mean()),
        "wrong": int(not same) + sum(error > LIMIT for error in worst.values()),
    }


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Geometric mean and largest of the ratios."""
    ratios = [row["ratio"] for row in found]
    return {
        "ratio": geometric_mean(ratios) if ratios else None,
        "largest": max(ratios, default=None),
        "wrong": sum(row["wrong"] for row in found),
    }


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    header = ["mesh", "N", "map ms", "with closest ms", "ratio", "called ratio", "faces as points", "worst", "wrong"]
    table = [header, *(_line(row) for row in found)]
    if found:
        table.append([f"geometric mean {total['ratio']:.2f}, largest {total['largest']:.2f}"])
    return table


def _line(row: dict[str, Any]) -> list[str]:
    return [
        row["mesh"],
        str(row["resolution"]),
        f"{row.get('alone_ms', row['called_alone_ms']):.3g}",
        f"{row.get('both_ms', row['called_both_ms']):.3g}",
        f"{row['ratio']:.2f}",
        f"{row['ratio_called']:.2f}",
        f"{row['faces_as_points']:.4f}",
        f"{max(row['errors'].values()):.2f}",
        str(row["wrong"]),
    ]
