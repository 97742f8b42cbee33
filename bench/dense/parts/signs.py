"""Part `signs`: what the sign costs, as the time of a signed map over that of the distances alone.

Both are queries of a structure that is there. Distances alone are the same kernels without the stage that finds
winding numbers: it is replaced by zeros, so every value comes out positive. On a GPU both are replayed as CUDA graphs,
since the launches would take longer than some kernels.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import sdm
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import Case
from sdm.bench.common.timing import median
from sdm.bench.dense.job import Job, Ours, as_dict, recorded
from sdm.engine.ops import map_slab
from sdm.kernels.dense import query as dense

MESHES = ("rocker-arm", "nefertiti", "torus-1000000", "stanford-bunny")
SMALL = ("torus-2000",)
RESOLUTIONS = {True: (128, 256, 512), False: (64,)}
# The share of faces that is taken away from closed meshes, to have open ones of all sizes.
TAKEN = 0.001


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each mesh and grid; closed meshes also with some faces missing."""
    for case in job.cases(SMALL if job.quick else MESHES):
        for shown in (case, pierced(case)):
            ours = Ours(shown, job.device)
            if shown is not case and ours.index.closed:
                continue
            for resolution in (16,) if job.quick else RESOLUTIONS[job.gpu]:
                if not job.has_time(f"{shown.name} at {resolution}^3"):
                    continue
                grid = cube_around(case, resolution)
                signed = timed(job, ours, grid)
                with unsigned():
                    alone = timed(job, ours, grid)
                yield {
                    "mesh": shown.name,
                    "triangles": len(shown),
                    "resolution": resolution,
                    "closed": ours.index.closed,
                    "boundary_edges": int(
                        sdm.topology.boundary_edges.boundary_edges(ours.vertices, ours.faces).shape[0]
                    ),
                    "signed": signed,
                    "unsigned": alone,
                    "ratio": signed["ms"] / alone["ms"],
                }


def pierced(case: Case, taken: float = TAKEN) -> Case:
    """The mesh without this share of its faces; where these are few, each leaves a hole of its own."""
    keep = np.ones(len(case), bool)
    keep[np.random.default_rng(0).choice(len(case), max(1, int(taken * len(case))), replace=False)] = False
    return Case(f"{case.name} with holes", case.vertices, case.faces[keep], frozenset({"open"}))


@contextmanager
def unsigned() -> Iterator[None]:
    """Maps made meanwhile have no signs."""
    before = dense.slab_winding
    dense.slab_winding = lambda tree, winding, slab, values, *_, **__: values.zero_()
    try:
        yield
    finally:
        dense.slab_winding = before


def timed(job: Job, ours: Ours, grid: sdm.Grid) -> dict[str, float]:
    """Milliseconds of a query."""

    def query() -> Any:
        index = ours.index
        return map_slab(ours.vertices[None], ours.faces, index._structure, grid, 0, grid.shape[0])[0]

    call = recorded(query)[0] if job.gpu else query
    call()
    return as_dict(median(call, job.device, job.runs, 500.0))


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """The largest ratios."""
    closed = [row["ratio"] for row in found if row["closed"]]
    opened = [row["ratio"] for row in found if not row["closed"]]
    return {"closed": max(closed, default=None), "open": max(opened, default=None)}


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["mesh", "boundary edges", "N", "signed ms", "unsigned ms", "ratio"]]
    for row in found:
        figures = [f"{row['signed']['ms']:.3g}", f"{row['unsigned']['ms']:.3g}", f"{row['ratio']:.2f}"]
        table.append([row["mesh"], str(row["boundary_edges"]), str(row["resolution"]), *figures])
    for kind, ratio in total.items():
        if ratio is not None:
            table.append([f"largest ratio of {kind} meshes: {ratio:.2f}"])
    return table
