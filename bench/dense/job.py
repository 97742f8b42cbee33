"""Tools of the parts of `sdm.bench.dense`: the job, fair clocks, checks, memory, and a peer on a part of a grid."""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import sdm
from sdm.bench.common.correctness import compare, voxel_centres
from sdm.bench.common.meshes import Case, load_case, missing_note
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.query_points import generator
from sdm.bench.common.timing import Timing, median, once
from sdm.bench.dense.first import FEWEST_SPLIT, fresh, split
from sdm.bench.peers import Peer
from sdm.runtime import graphs

MIB = 1 << 20
# Slabs of a grid that stand for all of it, one drawn in each of as many equal parts.
SLABS = 8
# First calls of meshes of other counts on a GPU; the median counts. One on a CPU, where it is like any other.
FIRST_CALLS = 3


@dataclass
class Job:
    """Job of one part: device, sizes, and the time it has.

    Args:
        device: "cpu" or "cuda".
        quick: In miniature.
        budget_s: Seconds for the part. What is begun is finished; what would begin later is left out, and said.
        runs: Timed calls for each of sdm's figures; the median counts.
        notes: Sentences for the reader: what was left out and why.
    """

    device: str
    quick: bool
    budget_s: float
    runs: int = 7
    notes: list[str] = field(default_factory=list)
    started: float = field(default_factory=time.monotonic)

    @property
    def gpu(self) -> bool:
        """True if it runs on a GPU."""
        return self.device.startswith("cuda")

    @property
    def left_s(self) -> float:
        """Seconds left of the budget."""
        return self.budget_s - (time.monotonic() - self.started)

    def has_time(self, what: str) -> bool:
        """True if there is time to begin `what`; noted if not."""
        if self.left_s > 0:
            return True
        self.notes.append(f"{what} was left out: the part's {self.budget_s:g} s were over")
        return False

    def cases(self, names: tuple[str, ...]) -> Iterator[Case]:
        """The meshes whose files are here; the others are noted."""
        for name in names:
            if (note := missing_note(name)) is not None:
                self.notes.append(note)
            else:
                yield load_case(name)


@dataclass
class Ours:
    """`sdm` on one mesh whose arrays are on the device: each step is a call of its own, to be timed."""

    case: Case
    device: str

    def __post_init__(self) -> None:
        self.vertices = torch.from_numpy(self.case.vertices).to(self.device)
        self.faces = torch.from_numpy(self.case.faces).to(self.device)
        self.index = self.build()

    def build(self) -> sdm.MeshIndex:
        """A structure over faces that were seen before: what a mesh that moves costs."""
        mesh = sdm.TriangleMesh(self.vertices, self.faces, self.case.name, check=False)
        return sdm.MeshIndex(mesh, self.device)

    def build_new(self) -> sdm.MeshIndex:
        """The same over faces never seen before, so that their topology is found too: what a new mesh costs."""
        mesh = sdm.TriangleMesh(self.vertices, self.faces.clone(), self.case.name, check=False)
        return sdm.MeshIndex(mesh, self.device)

    def map(self, grid: sdm.Grid) -> Tensor:
        """The map, the structure being there."""
        return self.index.signed_distance_map(grid).values

    def map_new(self, grid: sdm.Grid) -> Tensor:
        """The map from copies of vertices and faces, as a user's call makes it: topology, structure and map."""
        mesh = sdm.TriangleMesh(self.vertices.clone(), self.faces.clone(), self.case.name, check=False)
        return sdm.signed_distance_map(mesh, grid, device=self.device).values


def time_ours(job: Job, ours: Ours, grid: sdm.Grid, budget_s: float = 2.0) -> tuple[dict[str, Any], Tensor]:
    """Milliseconds of sdm's steps on a grid, warm, with their spread and peak memory; and the map."""
    # No row is slower to be recorded for those before it.
    graphs.clear()
    cold, first = first_calls(job, ours, grid)
    values = ours.map_new(grid)
    if job.gpu:
        # The third call is recorded, so those that are timed are replayed.
        for _ in range(graphs.CALLS):
            ours.map_new(grid)
            ours.map(grid)
    budget = 1e3 * budget_s
    new = median(lambda: ours.map_new(grid), job.device, job.runs, budget)
    query = median(lambda: ours.map(grid), job.device, job.runs, budget)
    row = {
        "new_mesh": as_dict(new),
        "query": as_dict(query),
        "build_new": as_dict(median(ours.build_new, job.device, job.runs, budget / 4)),
        "build": as_dict(median(ours.build, job.device, job.runs, budget / 4)),
        "first_ms": first,
        "cold_ms": cold,
        "mvoxels_per_second": grid.size / new.ms / 1e3,
        "map_mib": grid.nbytes / MIB,
        "peak_mib": peak_mib(job, lambda: ours.map_new(grid)),
    }
    return row, values


def first_calls(job: Job, ours: Ours, grid: sdm.Grid) -> tuple[float, float]:
    """Milliseconds of the first map on a grid, and of first maps of meshes of other counts after it, the median.

    The first one loads kernels, and on a GPU records what serves meshes of about this size.
    """
    cold, *others = (
        once(
            partial(sdm.signed_distance_map, fresh(split(ours.case, FEWEST_SPLIT + number), job.device), grid),
            job.device,
        )[0]
        for number in range(1 + (FIRST_CALLS if job.gpu else 1))
    )
    return cold, statistics.median(others)


def recorded(call: Callable[[], Tensor]) -> tuple[Callable[[], None], Tensor]:
    """A call as a CUDA graph: how to launch it again, and the tensor that it then fills."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(2):
            call()
    torch.cuda.current_stream().wait_stream(stream)
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, stream=stream):
        values = call()
    return graph.replay, values


def as_dict(timing: Timing) -> dict[str, float]:
    """For a JSON file."""
    return {"ms": timing.ms, "spread_percent": timing.spread, "runs": timing.runs}


def peak_mib(job: Job, call: Callable[[], Any]) -> float | None:
    """Most memory that a call holds at a time beyond what was held before, in MiB; None on a CPU.

    Without a recording, which would hold its part of it beforehand.
    """
    if not job.gpu:
        return None
    with graphs.paused():
        torch.cuda.synchronize()
        before = torch.cuda.memory_allocated()
        torch.cuda.reset_peak_memory_stats()
        call()
        torch.cuda.synchronize()
    return (torch.cuda.max_memory_allocated() - before) / MIB


def check_map(job: Job, case: Case, grid: sdm.Grid, values: Tensor, count: int) -> dict[str, Any]:
    """Compare `count` voxels of a map with the float64 brute force: half anywhere, half within two voxels of zero."""
    rng = generator(case, f"checked {grid.shape}")
    flat = values.reshape(-1)
    some = torch.from_numpy(rng.integers(0, grid.size, 1 << 16)).to(flat.device)
    near = some[(flat[some].abs() < 2 * max(grid.spacing)).nonzero()[:, 0]][: count // 2]
    which = torch.cat([some[: count - near.shape[0]], near])
    at = voxel_centres(grid, which.cpu().numpy())
    brute = Brute(case.vertices, case.faces, job.device)
    tally = compare(case, at, flat[which].cpu().numpy(), brute.distance(at)[0], brute.winding_number(at))
    return {**tally.as_dict(), "near_surface": int(near.shape[0])}


def wrong_in(found: list[dict[str, Any]]) -> int:
    """Values with a wrong sign, or further off than the limit, of all that a part checked."""
    return sum(row["checked"]["wrong_signs"] + row["checked"]["over_limit"] for row in found)


def error_cell(row: dict[str, Any]) -> str:
    """The largest error that a row checked, in roundings, for a table."""
    error = row["checked"]["max_error"]
    return "not finite" if error is None else f"{error:.2f}"


def slabs_of(case: Case, grid: sdm.Grid, share: float, fewest: int = 1) -> list[tuple[int, int]]:
    """Layers (begin, end) along x that hold about `share` of a grid: one random slab in each of `SLABS` equal parts.

    A slab has at least two layers: some peers do not know a grid of one. It has at least `fewest` points, if need be in
    place of several slabs.
    """
    if share >= 1:
        return [(0, grid.shape[0])]
    least = max(2, math.ceil(fewest / (grid.shape[1] * grid.shape[2])))
    edges = np.linspace(0, grid.shape[0], max(1, min(SLABS, grid.shape[0] // least)) + 1).round().astype(int)
    rng = generator(case, f"slabs {grid.shape}")
    chosen = []
    for low, high in itertools.pairwise(edges):
        layers = min(high - low, max(least, round(share * (high - low))))
        begin = int(rng.integers(low, high - layers + 1))
        chosen.append((begin, begin + layers))
    return chosen


def part_of(grid: sdm.Grid, begin: int, end: int) -> sdm.Grid:
    """Layers begin to end of a grid, as a grid."""
    origin = (grid.origin[0] + begin * grid.spacing[0], *grid.origin[1:])
    return sdm.Grid(origin, grid.spacing, (end - begin, *grid.shape[1:]))


def time_peer(
    job: Job, peer: Peer, case: Case, grid: sdm.Grid, values: Tensor | None, budget_s: float
) -> dict[str, Any]:
    """Time of a peer that was built on `case`, on the whole grid or on random slabs of it, scaled up.

    Also where it and the map `values` differ on the timed voxels: a peer that answers another question is no rival.
    """
    trial = [part_of(grid, *slab) for slab in slabs_of(case, grid, 1 / grid.shape[0], peer.fewest_points)]
    call_part(peer, trial[0])  # compiles
    each = sum(call_part(peer, part)[0] for part in trial) / sum(part.size for part in trial)
    # A warm-up, then at least three timed calls.
    share = 1e3 * budget_s / 4 / (each * grid.size)
    slabs = slabs_of(case, grid, share, peer.fewest_points)
    parts = [part_of(grid, *slab) for slab in slabs]
    differs, worst = 0, 0.0
    for part, (begin, end) in zip(parts, slabs, strict=True):
        found = call_part(peer, part)[1]
        if values is not None:
            mine = values[begin:end]
            clear = mine.abs() > 1e-5 * max(grid.spacing) * max(grid.shape)
            differs += int((((found < 0) != (mine < 0)) & clear).sum())
            worst = max(worst, float((found.abs() - mine.abs()).abs().max()))
    times: list[float] = []
    while len(times) < 3 or (len(times) < job.runs and sum(times) + max(times) < 1e3 * budget_s * 3 / 4):
        times.append(call_parts(peer, parts))
    asked = sum(part.size for part in parts)
    middle = statistics.median(times)
    return {
        "peer": peer.name,
        "note": peer.note,
        "ms": middle * grid.size / asked,
        "spread_percent": 100 * (max(times) - min(times)) / middle,
        "runs": len(times),
        "share": asked / grid.size,
        "mvoxels_per_second": asked / middle / 1e3,
        "signs_unlike_ours": differs if values is not None else None,
        "largest_difference": worst if values is not None else None,
    }


def call_part(peer: Peer, part: sdm.Grid) -> tuple[float, Tensor]:
    """Milliseconds of a peer's map of a part of a grid, prepared before, and the map."""
    peer.prepare(part)
    return once(lambda: peer.signed_distance_map(part), peer.device)


def call_parts(peer: Peer, parts: list[sdm.Grid]) -> float:
    """Milliseconds of several parts: on a GPU one after the other without waiting, as the whole grid would be."""
    if peer.device.startswith("cuda"):
        return once(lambda: [peer.signed_distance_map(part) for part in parts], peer.device)[0]
    return sum(call_part(peer, part)[0] for part in parts)


def geometric_mean(values: list[float]) -> float:
    """Of positive numbers."""
    return statistics.geometric_mean(values)


def exponent(sizes: list[float], times: list[float]) -> float:
    """Slope of the straight line through log time over log size: 1 is linear."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
