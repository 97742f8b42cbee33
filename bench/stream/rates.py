"""Maps a second of the stream, and where a batch's time goes."""

from __future__ import annotations

import statistics
from typing import Any

import torch

from sdm import signed_distance_maps
from sdm.bench.common.correctness import compare
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import median
from sdm.bench.stream.sizes import Bench
from sdm.engine.acceleration import build
from sdm.topology.boundary_edges import boundary_edges

BATCHES = (1, 16, 64)
RUNS, BUDGET_MS = 20, 1500.0
# Voxels of each map that are checked.
CHECKED = 2_000


def rates(bench: Bench) -> dict[str, Any]:
    """Maps a second for each size of a batch; milliseconds of its vertices, hierarchy and query."""
    check(bench)
    faces = bench.family.faces_on(bench.device)
    rows = []
    for size in BATCHES if bench.gpu else (1, 4):
        theta = bench.family.sample(size, device=bench.device)
        vertices = bench.family.vertices(theta)
        edges = boundary_edges(vertices, faces)
        steps = {
            "vertices": lambda t=theta: bench.family.vertices(t),
            "build": lambda v=vertices, e=edges: build(v, faces, e),
            "maps": lambda v=vertices: signed_distance_maps(v, faces, bench.grid),
        }
        ms = {}
        for name, step in steps.items():
            step()
            ms[name] = median(step, bench.device, RUNS, BUDGET_MS).ms
        ms["query"] = ms["maps"] - ms["build"]
        batches = iter(bench.stream(size))
        count = bench.calls(lambda b=batches: next(b))
        runs = [size * bench.speed(lambda b=batches: next(b), count) for _ in range(3)]
        rows.append({"batch": size, "maps_per_second": statistics.median(runs), "runs": runs, "ms": ms})
    return {"triangles": len(bench.family.faces), "resolution": bench.resolution, "batches": rows}


def check(bench: Bench) -> None:
    """The stream's maps against every triangle in float64, distance and sign, at some voxels.

    Raises:
        SystemExit: They are wrong.
    """
    batch = bench.stream(2).sample([0, 1])
    points = bench.grid.points().reshape(-1, 3)
    some = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))[:CHECKED]
    at = points[some].numpy()
    faces = bench.family.faces.numpy()
    for vertices, values in zip(bench.family.vertices(batch.theta).cpu().numpy(), batch.sdm.cpu(), strict=True):
        brute = Brute(vertices, faces, bench.device)
        case = Case("cochlea", vertices, faces, frozenset())
        tally = compare(case, at, values.reshape(-1)[some].numpy(), brute.distance(at)[0], brute.winding_number(at))
        if not tally.fine:
            raise SystemExit(f"the stream is wrong, so nothing was timed: {tally}")
