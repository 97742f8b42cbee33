"""Part `worst`: meshes made to overflow lists and unbalance work, each beside an ordinary mesh of the same size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sdm.bench.common.grids import cube_around, turned_around
from sdm.bench.common.mesh_formulas import Arrays, cube, joined, moved, sphere, torus
from sdm.bench.common.meshes import Case, load_case
from sdm.bench.dense.job import Job, Ours, check_map, error_cell, time_ours, wrong_in

TRIANGLES = 1_000_000
RESOLUTION = 128
CHECKED = 4000
# At most so many times the ordinary mesh's time.
LIMIT = 20
# The ordinary mesh on a turned grid of voxels twice as long as wide: half the voxels, boxes around cells much larger.
LONG_VOXELS = "turned, long voxels"
# A tiny sphere's diameter as a share of a voxel's edge, and its centre's place in the box of the cube around it.
TINY, PLACE = 0.8, (0.31, 0.17, -0.23)


def ball(triangles: int) -> Arrays:
    """A sphere: at its centre every triangle is as near as every other."""
    return sphere(rings_for(triangles))


def one_voxel(triangles: int, resolution: int) -> Arrays:
    """A cube with a sphere of many triangles in it that is smaller than one voxel of a grid around the cube."""
    voxel = 2.2 / (resolution - 1)
    return joined(cube(), moved(sphere(rings_for(triangles)), TINY * voxel / 2, PLACE))


def coincident(triangles: int, shells: int) -> Arrays:
    """The same torus several times: each distance is reached by as many triangles."""
    return joined(*[torus(triangles // shells)] * shells)


def rings_for(triangles: int) -> int:
    """Rings of a sphere of about so many triangles."""
    return max(3, round((triangles / 4) ** 0.5))


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each mesh, with its ratio to an ordinary one of as many triangles."""
    count = 1_000 if job.quick else TRIANGLES if job.gpu else TRIANGLES // 20
    resolution = 16 if job.quick else RESOLUTION if job.gpu else RESOLUTION // 2
    ordinary = load_case(f"torus-{count}")
    made = {
        "centre of a sphere": lambda: ball(count),
        "all in one voxel": lambda: one_voxel(count, resolution),
        "2 coincident shells": lambda: coincident(count, 2),
        "64 coincident shells": lambda: coincident(count, 64),
        LONG_VOXELS: lambda: (ordinary.vertices, ordinary.faces),
    }
    each = job.budget_s / 20
    usual, _ = time_ours(job, Ours(ordinary, job.device), cube_around(ordinary, resolution), each)
    for name, make in made.items():
        if not job.has_time(name):
            continue
        case = Case(name, *make(), frozenset())
        grid = turned_around(case, resolution) if name == LONG_VOXELS else cube_around(case, resolution)
        row, values = time_ours(job, Ours(case, job.device), grid, each)
        yield {
            "mesh": name,
            "triangles": len(case),
            "resolution": resolution,
            "shape": list(grid.shape),
            **row,
            "ordinary": {"mesh": ordinary.name, "triangles": len(ordinary), **usual},
            "ratio_to_ordinary": row["new_mesh"]["ms"] / usual["new_mesh"]["ms"],
            "query_ratio_to_ordinary": row["query"]["ms"] / usual["query"]["ms"],
            "checked": check_map(job, case, grid, values, CHECKED),
        }


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """The worst ratio, and what was wrong."""
    return {
        "worst_ratio": max((row["ratio_to_ordinary"] for row in found), default=None),
        "limit": LIMIT,
        "wrong": wrong_in(found),
    }


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["mesh", "triangles", "N", "map ms", "query", "ordinary ms", "ratio", "peak MiB", "error", "wrong"]]
    table += [
        [
            row["mesh"],
            f"{row['triangles']:,}",
            str(row["resolution"]),
            f"{row['new_mesh']['ms']:.4g}",
            f"{row['query']['ms']:.4g}",
            f"{row['ordinary']['new_mesh']['ms']:.4g}",
            f"{row['ratio_to_ordinary']:.2f}",
            "-" if row["peak_mib"] is None else f"{row['peak_mib']:,.0f}",
            error_cell(row),
            str(row["checked"]["wrong_signs"]),
        ]
        for row in found
    ]
    return table
