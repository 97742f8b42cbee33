"""Part `slices`: a mesh in slices thick and thin, as clinical images are, and what a finer grid is worth there.

On a CPU maps of thick slices are measured on a finer grid (`sdm.engine.thick_slices`); beside that, the same without.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sdm.bench.common.grids import sliced_around
from sdm.bench.common.timing import median
from sdm.bench.dense.job import Job, Ours, as_dict, check_map, error_cell, time_ours, wrong_in
from sdm.bench.dense.parts.signs import pierced
from sdm.engine.plan_override import plan_override

MESHES = ("rocker-arm", "nefertiti", "torus-20000")
# The last once more without this share of its triangles, so that signs are most of the work.
TAKEN = 0.01
ACROSS, SLICES = 192, (96, 48, 24, 12, 6)
CHECKED = 2000


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each mesh and number of slices."""
    across, slices = (48, (12, 6)) if job.quick else (ACROSS, SLICES)
    whole = list(job.cases(("torus-2000",) if job.quick else MESHES))
    for case in [*whole, pierced(whole[-1], TAKEN)]:
        ours = Ours(case, job.device)
        for count in slices:
            if not job.has_time(f"{case.name} in {count} slices"):
                continue
            grid = sliced_around(case, across, count)
            each = job.budget_s / (len(whole) + 1) / len(slices) / 4
            row, values = time_ours(job, ours, grid, each)
            with plan_override(slice_factors=(1,)):
                plain = median(lambda ours=ours, grid=grid: ours.map_new(grid), job.device, job.runs, 1e3 * each)
            yield {
                "mesh": case.name,
                "triangles": len(case),
                "resolution": across,
                "slices": count,
                **row,
                "as_they_are": as_dict(plain),
                "ratio": plain.ms / row["new_mesh"]["ms"],
                "checked": check_map(job, case, grid, values, CHECKED),
            }


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Wrong values, and the gain by finer grids at most and at least."""
    ratios = [row["ratio"] for row in found]
    return {
        "largest_ratio": max(ratios, default=None),
        "smallest_ratio": min(ratios, default=None),
        "wrong": wrong_in(found),
    }


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["mesh", "slices", "Mvoxel/s", "map ms", "± %", "as they are ms", "ratio", "error", "wrong"]]
    table += [
        [
            row["mesh"],
            f"{row['slices']} of {row['resolution']}^2",
            f"{row['mvoxels_per_second']:,.4g}",
            f"{row['new_mesh']['ms']:.4g}",
            f"{row['new_mesh']['spread_percent']:.0f}",
            f"{row['as_they_are']['ms']:.4g}",
            f"{row['ratio']:.2f}",
            error_cell(row),
            str(row["checked"]["wrong_signs"]),
        ]
        for row in found
    ]
    return table
