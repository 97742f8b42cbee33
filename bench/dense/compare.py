"""The comparison: every peer that is installed, checked against the brute force, then timed. `sdm bench`.

Compiling, building, the query, the sign and the way to the host and back are timed apart. How to add a mesh or a peer
of your own is in bench/README.md.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import sdm
from sdm.bench.common import query_points as sampling
from sdm.bench.common.correctness import compare, voxel_centres
from sdm.bench.common.machine import describe, version_of
from sdm.bench.common.meshes import Case, load_case, missing_note
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.own import Own, load_own
from sdm.bench.common.results_folder import folder_for, write_results
from sdm.bench.common.tables import print_results
from sdm.bench.common.timing import median, once
from sdm.bench.peers import Peer, all_peers
from sdm.core.device import choose_device
from sdm.errors import one_line

# Voxels or points whose values are compared with the brute force.
CHECKED = 4_000
# Enough points to tell how long all of them would take: two sizes, for what a call costs whatever their number.
TRIAL, LARGER_TRIAL = 200, 2_000
# As many of a larger grid's voxels are drawn at random.
MOST_ORDER = 1 << 22
# A map of as many fewer voxels along each axis tells how long the whole one will take, at most.
COARSER = 4
# Parts of a query are timed on all its points; larger grids leave them out.
MOST_PART_POINTS = 1 << 25


@dataclass
class Options:
    """Options of a comparison: meshes, grids, peers, budget.

    Args:
        device: "cpu" or "cuda"; None for a GPU if there is one.
        meshes: Names from bench/common/meshes.py, "torus-N", or files; None for a choice.
        resolutions: Voxels along each axis of the grids; None for a choice.
        points: Also query this many scattered points, half of them near the surface; 0 for none.
        peers: Words of which a peer's name must hold one, in any case; None for all.
        runs: Timed calls for each figure; the median counts.
        budget_s: About how long one peer may take for one mesh and grid. A peer that would take longer is timed on
            fewer voxels, chosen at random, and the table says how many. One that does better on a whole map than
            voxel by voxel is judged by a coarse map.
        quick: Small choices: under a minute on two cores, compiling aside.
        out: Also write the results: to this file if it ends with .json, else to this folder, with tables and plots.
        add: Python files with meshes and peers of one's own: see bench/common/own.py.
    """

    device: str | None = None
    meshes: Sequence[str] | None = None
    resolutions: Sequence[int] | None = None
    points: int = 0
    peers: Sequence[str] | None = None
    runs: int = 5
    budget_s: float = 30.0
    quick: bool = False
    out: Path | None = None
    add: Sequence[Path] = ()

    def filled(self) -> Options:
        """With every choice made.

        Raises:
            SDMError: A number that makes no sense.
        """
        if self.runs < 1 or not self.budget_s > 0 or self.points < 0:
            raise sdm.SDMError("runs must be at least 1, points at least 0, and the budget a positive time in seconds")
        device = self.device or ("cuda" if torch.cuda.is_available() else "cpu")
        gpu = device.startswith("cuda")
        meshes = ("torus-20000", "rocker-arm")
        resolutions = (32, 64) if gpu else (16, 32)
        if not self.quick:
            meshes = (*meshes, "stanford-bunny", "nefertiti", *(("torus-1000000",) if gpu else ()))
            resolutions = (64, 128, 256) if gpu else (64,)
        return Options(
            device=device,
            meshes=self.meshes or meshes,
            resolutions=self.resolutions or resolutions,
            points=self.points,
            peers=self.peers,
            runs=min(self.runs, 3) if self.quick else self.runs,
            budget_s=min(self.budget_s, 1.0) if self.quick else self.budget_s,
            quick=self.quick,
            out=self.out,
            add=self.add,
        )


@dataclass
class Question:
    """One thing to ask of every peer: a grid, or scattered points; with the truth at some of them."""

    title: str
    case: Case
    size: int
    points: Callable[[np.ndarray | None], np.ndarray]  # all of them, or those with these numbers
    grid: sdm.Grid | None
    order: np.ndarray = field(init=False)  # numbers of points at random: the first are checked
    truth: tuple[np.ndarray, np.ndarray] = field(init=False)

    def solve(self, brute: Brute) -> None:
        """Find the truth."""
        rng = sampling.generator(self.case, self.title)
        self.order = rng.permutation(self.size) if self.size <= MOST_ORDER else rng.integers(0, self.size, MOST_ORDER)
        checked = self.points(self.order[:CHECKED])
        self.truth = brute.distance(checked)[0], brute.winding_number(checked)

    def check(self, values: np.ndarray) -> dict[str, Any]:
        """Compare values at the first of `order`."""
        count = min(len(values), CHECKED, self.size)
        at = self.points(self.order[:count])
        return compare(self.case, at, values[:count], self.truth[0][:count], self.truth[1][:count]).as_dict()


def run(options: Options) -> int:
    """Compare, print one table for each question, and write the results if wanted; 1 if `sdm` itself is wrong.

    Raises:
        SDMError: A mesh or device that is not there, or no peer left.
    """
    own = load_own(options.add)
    if own.cases and not options.meshes:
        options = replace(options, meshes=tuple(own.cases))
    options = options.filled()
    device = options.device or "cpu"
    choose_device(device)
    if options.out is not None:
        # Before the measuring, which takes minutes.
        folder_for(options.out)
    known = [*all_peers(device), *own.peers(device)]
    peers = [p for p in known if not options.peers or any(w.lower() in p.name.lower() for w in options.peers)]
    if not peers:
        names = ", ".join(peer.name for peer in known)
        raise sdm.SDMError(f"no peer's name holds any of {', '.join(options.peers or ())}; there are {names}")
    missing = [note for peer in peers if (note := peer.missing()) is not None]
    peers = [peer for peer in peers if peer.available()]
    absent = {name: note for name in options.meshes or () if name not in own.cases and (note := missing_note(name))}
    there = [_case(name, own) for name in options.meshes or () if name not in absent]
    results = [result for case in there for result in _results(case, peers, device, options)]
    _progress("")
    packages = ("warp-lang", "torch", "numpy", *(peer.package for peer in peers))
    report = {**describe(device, packages), "results": results, "missing": missing, "left_out": [*absent.values()]}
    print_results(report)
    if options.out is not None:
        write_results(report, options.out)
    return int(any(row["peer"] == "sdm" and not row["fine"] for result in results for row in result["rows"]))


def _results(case: Case, peers: list[Peer], device: str, options: Options) -> list[dict[str, Any]]:
    """The answers of all peers to all questions about a mesh, a dictionary for each question."""
    upload = _upload(case, device, options)
    brute = Brute(case.vertices, case.faces, device)
    questions = _questions(case, options)
    for question in questions:
        question.solve(brute)
    answers: list[list[dict[str, Any]]] = [[] for _ in questions]
    for peer in peers:
        built = _build(peer, case, options)
        for question, rows in zip(questions, answers, strict=True):
            if question.grid is not None or peer.points_too:
                _progress(f"{question.title}: {peer.name}")
                rows.append(built | _measure(peer, question, options))
    of_all = {"mesh": case.name, "triangles": len(case), "upload_ms": upload}
    return [
        {"title": question.title, **of_all, "size": question.size, "rows": rows}
        for question, rows in zip(questions, answers, strict=True)
    ]


def _case(name: str, own: Own) -> Case:
    try:
        return own.cases[name] if name in own.cases else load_case(name)
    except KeyError as error:
        raise sdm.MeshError(str(error.args[0])) from error
    except sdm.SDMError:
        raise
    # Files are read by trimesh, as they are, and its readers raise whatever they come across.
    except Exception as error:
        raise sdm.MeshError(f"{name} cannot be read ({one_line(error)}): sdm inspect says more") from error


def _upload(case: Case, device: str, options: Options) -> float | None:
    """Milliseconds of the mesh's way to the device, from pageable memory; None on a CPU, where there is none."""
    if not device.startswith("cuda"):
        return None
    arrays = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    once(lambda: [array.to(device) for array in arrays], device)
    return median(lambda: [array.to(device) for array in arrays], device, options.runs).ms


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r{text:<78}", end="" if text else "\r", flush=True, file=sys.stderr)


def _questions(case: Case, options: Options) -> list[Question]:
    mesh = sdm.TriangleMesh(case.vertices, case.faces, case.name)
    found = []
    for resolution in options.resolutions or ():
        grid = sdm.Grid.around(mesh, resolution=resolution)

        title = f"{case.name} at {resolution}^3"
        found.append(Question(title, case, grid.size, functools.partial(voxel_centres, grid), grid))
    if options.points:
        half = options.points // 2
        scattered = np.concatenate([sampling.uniform(case, options.points - half), sampling.near(case, half)])

        def some(which: np.ndarray | None) -> np.ndarray:
            return scattered if which is None else scattered[which]

        found.append(Question(f"{case.name} at {options.points:,} points", case, len(scattered), some, None))
    return found


def _build(peer: Peer, case: Case, options: Options) -> dict[str, Any]:
    first, _ = once(lambda: peer.build(case), peer.device)
    timing = median(lambda: peer.build(case), peer.device, options.runs, 1e3 * options.budget_s / 4)
    return {
        "peer": peer.name,
        "device": peer.device,
        "note": peer.note,
        "version": version_of(peer.package),
        "build_ms": timing.ms,
        "first_build_ms": first,
    }


def _measure(peer: Peer, question: Question, options: Options) -> dict[str, Any]:
    """Check one peer's answers to one question, then time it."""
    device, budget = peer.device, 1e3 * options.budget_s
    asked, warm_up = question.size, 0.0
    if peer.points_too and not _whole_map_fits(peer, question, budget):
        asked, warm_up = _affordable(peer, question, budget)
    if asked < question.size:
        some = torch.from_numpy(question.points(question.order[:asked])).to(device)
        call: Callable[[], Tensor] = lambda: peer.signed_distance(some)  # noqa: E731
        pick = slice(None)
    elif question.grid is not None:
        grid = question.grid
        peer.prepare(grid)
        call, pick = lambda: peer.signed_distance_map(grid), question.order[:CHECKED]
    else:
        some = torch.from_numpy(question.points(None)).to(device)
        call, pick = lambda: peer.signed_distance(some), question.order[:CHECKED]

    first, values = once(call, device)
    tally = question.check(values.reshape(-1)[pick].cpu().numpy())
    download = median(values.cpu, device, options.runs, budget / 4).ms if device.startswith("cuda") else None
    del values
    timing = median(call, device, options.runs, budget)
    row = {
        "asked": asked,
        "query_ms": timing.ms,
        "spread_percent": timing.spread,
        "runs": timing.runs,
        "million_per_second": asked / timing.ms / 1e3,
        "first_call_ms": warm_up + first,
        "download_ms": download,
        **tally,
        "fine": tally["over_limit"] == 0 and tally["wrong_signs"] == 0,
    }
    if peer.parts and asked <= MOST_PART_POINTS:
        which = None if asked == question.size else question.order[:asked]
        at = torch.from_numpy(question.points(which)).to(device)
        for part, function in (("distance", peer.unsigned_distance), ("sign", peer.inside)):
            if part in peer.parts:
                function(at[:TRIAL])  # compiles
                row[f"{part}_ms"] = median(lambda f=function: f(at), device, options.runs, budget / 2).ms
    return row


def _whole_map_fits(peer: Peer, question: Question, budget: float) -> bool:
    """True if a peer with its own way to make maps has time for this one, judged by one a quarter as fine."""
    if question.grid is None or type(peer).signed_distance_map is Peer.signed_distance_map:
        return False
    shape = [-(-n // COARSER) for n in question.grid.shape]
    coarse = sdm.Grid(question.grid.origin, [COARSER * step for step in question.grid.spacing], shape)
    peer.prepare(coarse)
    once(lambda: peer.signed_distance_map(coarse), peer.device)
    ms, _ = once(lambda: peer.signed_distance_map(coarse), peer.device)
    # As in `_affordable`: the first call, and at least half a call more.
    return ms * question.size / coarse.size <= budget / 1.5


def _affordable(peer: Peer, question: Question, budget: float) -> tuple[int, float]:
    """Number of points that a peer can answer within the budget, and the milliseconds of its first call."""
    trial = torch.from_numpy(question.points(question.order[:LARGER_TRIAL])).to(peer.device)
    warm_up, _ = once(lambda: peer.signed_distance(trial[:TRIAL]), peer.device)
    small, _ = once(lambda: peer.signed_distance(trial[:TRIAL]), peer.device)
    each = small / TRIAL
    if each * len(trial) < budget / 4:
        larger, _ = once(lambda: peer.signed_distance(trial), peer.device)
        each = max(larger - small, 1e-6) / max(len(trial) - TRIAL, 1)
    # The first call, and at least half a call more.
    most = int(budget / 1.5 / each)
    return (question.size if most >= question.size else max(TRIAL, min(most // 2, len(question.order)))), warm_up
