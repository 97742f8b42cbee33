"""Part `points`: millions of scattered points, anywhere and near the surface, against stock Warp's winding query."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.correctness import compare
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import median, once
from sdm.bench.dense.job import Job, Ours, as_dict, error_cell, geometric_mean, peak_mib, wrong_in
from sdm.bench.peers import StockWarp

MESHES = ("rocker-arm", "stanford-bunny", "nefertiti", "torus-1000000")
COUNT = 10_000_000
CHECKED = 1_000
# As in bench/common/query_points.py, but made on the device: ten million on a host take longer than the query.
MARGIN, NEAR = 0.1, 2.0 / 128


def uniform(case: Case, count: int, device: str) -> Tensor:
    """Points (count,3) anywhere in the mesh's box and a tenth of its longest edge around it."""
    low, high = (torch.from_numpy(x).float().to(device) for x in case.box)
    room = MARGIN * (high - low).max()
    made = torch.Generator(device).manual_seed(1)
    return low - room + (high - low + 2 * room) * torch.rand(count, 3, generator=made, device=device)


def near(case: Case, count: int, device: str) -> Tensor:
    """Points (count,3) within two voxels of a 128^3 grid from random places of random triangles."""
    made = torch.Generator(device).manual_seed(2)
    corners = torch.from_numpy(case.vertices[case.faces]).to(device)
    face = torch.randint(len(case), (count,), generator=made, device=device)
    weights = torch.rand(count, 3, generator=made, device=device).clamp(min=1e-6).log()
    weights = weights / weights.sum(1, keepdim=True)
    step = torch.nn.functional.normalize(torch.randn(count, 3, generator=made, device=device), dim=1)
    low, high = case.box
    reach = NEAR * float((high - low).max())
    step = step * (reach * torch.rand(count, 1, generator=made, device=device))
    return (corners[face] * weights[:, :, None]).sum(1) + step


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each mesh and kind of points."""
    count = 5_000 if job.quick else COUNT if job.gpu else COUNT // 100
    for case in job.cases(("torus-2000",) if job.quick else MESHES):
        ours, stock = Ours(case, job.device), StockWarp(job.device)
        stock.build(case)
        for kind, make in (("uniform", uniform), ("near", near)):
            if not job.has_time(f"{kind} points of {case.name}"):
                continue
            points = make(case, count, job.device)
            # No build in either: points are asked of a mesh again and again.
            call = lambda ours=ours, at=points: ours.index.signed_distance(at)  # noqa: E731
            ask = lambda stock=stock, at=points: stock.signed_distance(at)  # noqa: E731
            (first, values), (_, theirs) = once(call, job.device), once(ask, job.device)
            mine = median(call, job.device, job.runs, 2e3)
            other = median(ask, job.device, job.runs, 2e3)
            at = points[:CHECKED].cpu().numpy()
            brute = Brute(case.vertices, case.faces, job.device)
            truth = brute.distance(at)[0], brute.winding_number(at)
            yield {
                "mesh": case.name,
                "triangles": len(case),
                "kind": kind,
                "points": count,
                "query": as_dict(mine),
                "first_ms": first,
                "build_new": as_dict(median(ours.build_new, job.device, job.runs, 500)),
                "mpoints_per_second": count / mine.ms / 1e3,
                "peak_mib": peak_mib(job, call),
                "stock": as_dict(other),
                "ratio": other.ms / mine.ms,
                "checked": compare(case, at, values[:CHECKED].cpu().numpy(), *truth).as_dict(),
                "stock_checked": compare(case, at, theirs[:CHECKED].cpu().numpy(), *truth).as_dict(),
            }


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Geometric means of the ratios for each kind of points."""
    kinds = sorted({row["kind"] for row in found})
    means = {kind: geometric_mean([row["ratio"] for row in found if row["kind"] == kind]) for kind in kinds}
    wrong = wrong_in(found)
    return {"geometric_means": means, "wrong": wrong}


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["mesh", "points", "Mpoint/s", "query ms", "± %", "build ms", "error", "wrong", "stock ms", "ratio"]]
    table += [
        [
            row["mesh"],
            f"{row['points']:,} {row['kind']}",
            f"{row['mpoints_per_second']:,.4g}",
            f"{row['query']['ms']:.4g}",
            f"{row['query']['spread_percent']:.0f}",
            f"{row['build_new']['ms']:.3g}",
            error_cell(row),
            str(row["checked"]["wrong_signs"]),
            f"{row['stock']['ms']:.4g}",
            f"{row['ratio']:.2f}",
        ]
        for row in found
    ]
    for kind, mean in total["geometric_means"].items():
        table.append([f"geometric mean of {kind} points: {mean:.2f}"])
    return table
