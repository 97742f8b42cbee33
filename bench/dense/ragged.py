"""Meshes that differ, in one call, beside single calls and a loop over stock Warp.

    python -m sdm.bench.dense.ragged --device cuda --out ragged-cuda.json
    python -m sdm.bench.dense.ragged --points 10000 --lists alike torn open --out ragged-points-cuda.json

Lists of shapes, no two alike: `alike`, 64 closed ones of about 20,000 triangles, `wide`, 1,000 of 1,000 to 100,000,
evenly over the logarithm, `torn`, 64 of about 20,000 of which half miss 0.1 to 30 % of their faces, and `open`, of
which all do. Each is made into maps of `--resolution` voxels an axis around each mesh: by one call of
`signed_distance_maps`, by a loop over `signed_distance_map`, and by a loop over stock Warp's query with either of its
builders. With `--points` so many scattered points around each mesh are asked about instead, by `signed_distances`,
`signed_distance` and stock's query. Vertices and faces are on the device and were never seen before by the call that is
timed. Ours counts everything: `joint` is `--runs` calls in a row, `joint_one_call` one from an idle device on. Of stock
the queries are timed alone, and with builds. The loops take `--some` of the meshes, evenly chosen.
Before that all answers are compared: bit for bit with single calls, and at random voxels or points with a float64 brute
force.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

import sdm
from sdm.bench.common import json_file, query_points
from sdm.bench.common.correctness import compare, voxel_centres
from sdm.bench.common.dirty_meshes.by_code import torn
from sdm.bench.common.figure import drawing, plain_ticks
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, sphere, torus
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import once
from sdm.bench.peers.warp import StockWarp, StockWarpSah
from sdm.runtime import graphs

LISTS = {
    "alike": (64, 16_000, 24_000),
    "wide": (1000, 1_000, 100_000),
    "torn": (64, 16_000, 24_000),
    "open": (64, 16_000, 24_000),
}
# Those that are measured if nobody says.
RECORDED = "alike", "wide", "torn"
# Of how many meshes one is torn, and shares of the faces that those miss.
TORN_OF = {"torn": 2, "open": 1}
LEAST_TORN, MOST_TORN = 0.001, 0.3
CHECKED = 40
# Names in the picture: of the ways to answer, and what is odd about a list.
WAYS = {"joint": "one call", "single": "a call each", "stock_lbvh": "stock Warp, LBVH", "stock_sah": "stock Warp, SAH"}
TOLD = {"torn": ", half of them torn", "open": ", all torn"}


def warped(number: int, triangles: int) -> Case:
    """A closed shape of about so many triangles: a sphere or a torus with bumps, stretched and moved."""
    rng = np.random.default_rng(number)
    round_one = number % 2 == 0
    vertices, faces = sphere(max(3, round((triangles / 4) ** 0.5))) if round_one else torus(triangles)
    waves, turns = rng.normal(size=(3, 3)) * 2, rng.uniform(0, 2 * np.pi, 3)
    bumps = 1 + 0.07 * np.sin(vertices @ waves.T + turns).sum(1, keepdims=True)
    placed = vertices * bumps * rng.uniform(0.6, 1.6, 3) + rng.normal(size=3)
    return Case(
        f"{'sphere' if round_one else 'torus'}-{number}", placed.astype(np.float32), faces, frozenset(["closed"])
    )


def list_of(name: str, count: int, fewest: int, most: int) -> list[Case]:
    """Shapes with numbers of triangles evenly over the logarithm, in random order."""
    sizes = np.exp(np.linspace(np.log(fewest), np.log(most), count)).astype(int)
    order = np.random.default_rng(len(name)).permutation(count)
    cases = [warped(int(number), int(sizes[number])) for number in order]
    if name in TORN_OF:
        shares, step = np.exp(np.linspace(np.log(LEAST_TORN), np.log(MOST_TORN), count)), TORN_OF[name]
        cases[::step] = [_torn(case, float(share)) for case, share in zip(cases[::step], shares[::step], strict=True)]
    return cases


def _torn(case: Case, share: float) -> Case:
    vertices, faces = torn((case.vertices, case.faces), share)
    return Case(f"{case.name} less {100 * share:.2g} %", vertices, faces, frozenset(["open"]))


def around(case: Case, resolution: int) -> sdm.Grid:
    """The cube of voxels around a shape, all of whose vertices count."""
    corners = np.stack([case.vertices.min(0), case.vertices.max(0), case.vertices.min(0)])
    return sdm.Grid.around((corners, [[0, 1, 2]]), resolution)


def fresh(cases: Sequence[Case], device: str) -> list[sdm.TriangleMesh]:
    """The meshes in new memory of the device."""
    return [
        sdm.TriangleMesh(
            torch.from_numpy(case.vertices).to(device), torch.from_numpy(case.faces).to(device), case.name, check=False
        )
        for case in cases
    ]


class Maps:
    """Question about each mesh of a list: its map on a grid around it."""

    what, of_each = "maps", "resolution"
    told: ClassVar[str] = "{}³"

    def __init__(self, cases: Sequence[Case], size: int, device: str) -> None:
        self.cases, self.size, self.device = cases, size, device
        self._grids = [around(case, size) for case in cases]

    def joint(self, meshes: list[sdm.TriangleMesh]) -> list[Any]:
        """The answers of all meshes by one call."""
        return sdm.signed_distance_maps(meshes, self._grids, device=self.device)

    def single(self, mesh: sdm.TriangleMesh, place: int) -> Any:
        """That of the mesh at a place, by a call of its own."""
        return sdm.signed_distance_map(mesh, self._grids[place], device=self.device)

    def prepare(self, peer: StockWarp, place: int) -> None:
        """Let a peer know what it will be asked."""
        peer.prepare(self._grids[place])

    def of_stock(self, peer: StockWarp, place: int) -> Tensor:
        """That of a peer, whose mesh is built."""
        return peer.signed_distance_map(self._grids[place])

    def values(self, found: Any) -> Tensor:
        """Distances of an answer, in one row."""
        return found.values.reshape(-1)

    def places(self, place: int, which: np.ndarray) -> np.ndarray:
        """Places (n,3) float32 of the distances with these numbers."""
        return voxel_centres(self._grids[place], which)


class Points(Maps):
    """Question about each mesh: distances of scattered points around it."""

    what, of_each = "sets of points", "points"
    told = "{:,} points"

    def __init__(self, cases: Sequence[Case], size: int, device: str) -> None:
        self.cases, self.size, self.device = cases, size, device
        self._points = [torch.from_numpy(query_points.uniform(case, size)).to(device) for case in cases]

    def joint(self, meshes: list[sdm.TriangleMesh]) -> list[Any]:
        return sdm.signed_distances(meshes, self._points, device=self.device)

    def single(self, mesh: sdm.TriangleMesh, place: int) -> Any:
        return sdm.signed_distance(mesh, self._points[place], device=self.device)

    def prepare(self, peer: StockWarp, place: int) -> None:
        pass

    def of_stock(self, peer: StockWarp, place: int) -> Tensor:
        return peer.signed_distance(self._points[place])

    def values(self, found: Any) -> Tensor:
        return found

    def places(self, place: int, which: np.ndarray) -> np.ndarray:
        return self._points[place].cpu().numpy()[which]


def check(asked: Maps, found: Sequence[Any]) -> dict[str, Any]:
    """Answers that differ from those of single calls, and errors at some random places."""
    cases, device = asked.cases, asked.device
    different, worst, wrong = 0, 0.0, 0
    for place, mesh in enumerate(fresh(cases, device)):
        different += not torch.equal(asked.values(asked.single(mesh, place)), asked.values(found[place]))
    for place in range(0, len(cases), max(1, len(cases) // 8)):
        case, values = cases[place], asked.values(found[place]).cpu().numpy()
        which = np.random.default_rng(0).choice(len(values), min(CHECKED, len(values)), replace=False)
        points = asked.places(place, which)
        brute = Brute(case.vertices, case.faces, device)
        tally = compare(case, points, values[which], brute.distance(points)[0], brute.winding_number(points))
        worst, wrong = max(worst, tally.max_error), wrong + tally.wrong_signs
    return {"different_from_single": different, "max_error": worst, "wrong_signs": wrong}


def seconds(call: Callable[[], Any], device: str) -> float:
    """Of one call, with the device idle before and waited for after."""
    return once(call, device)[0] / 1e3


def stock_rates(peer: StockWarp, asked: Maps, chosen: Sequence[int]) -> tuple[float, float]:
    """Seconds of queries and of builds, one mesh after the other."""
    built, queried = 0.0, 0.0
    for place in chosen:
        built += seconds(lambda place=place: peer.build(asked.cases[place]), asked.device)
        asked.prepare(peer, place)
        queried += seconds(lambda place=place: asked.of_stock(peer, place), asked.device)
    return queried, built


def row(name: str, asked: Maps, some: int, runs: int) -> dict[str, Any]:
    """The figures of one list."""
    cases, device = asked.cases, asked.device
    checked = check(asked, asked.joint(fresh(cases, device)))

    def joint(calls: int) -> float:
        """Meshes a second of so many calls in a row, the device idle before the first and waited for after the last."""
        lists = [fresh(cases, device) for _ in range(calls)]

        def call() -> None:
            for meshes in lists:
                asked.joint(meshes)

        return calls * len(cases) / seconds(call, device)

    in_a_row, alone = joint(runs), max(joint(1) for _ in range(2))
    chosen = range(0, len(cases), max(1, len(cases) // some))
    graphs.clear()
    meshes = fresh([cases[place] for place in chosen], device)
    single = sum(
        seconds(lambda mesh=mesh, place=place: asked.single(mesh, place), device)
        for mesh, place in zip(meshes, chosen, strict=True)
    )
    found = {
        "list": name,
        "meshes": len(cases),
        "triangles": int(sum(map(len, cases))),
        asked.of_each: asked.size,
        "joint": in_a_row,
        "joint_one_call": alone,
        "single": len(chosen) / single,
        **checked,
    }
    for peer in (StockWarp(device), *([StockWarpSah(device)] if device.startswith("cuda") else [])):
        stock_rates(peer, asked, chosen[:1])
        queried, built = stock_rates(peer, asked, chosen)
        key = "sah" if isinstance(peer, StockWarpSah) or device == "cpu" else "lbvh"
        found[f"stock_{key}"] = len(chosen) / queried
        found[f"stock_{key}_built"] = len(chosen) / (queried + built)
    return found


def draw(report: dict[str, Any], path: Path) -> None:
    """Maps, or sets of points, a second of each way, as bars for each list."""
    from matplotlib.ticker import LogLocator

    ways = [key for key in WAYS if key in report["rows"][0]]
    kind = next(kind for kind in (Maps, Points) if kind.of_each in report["rows"][0])
    with drawing(path, f"{report['machine']['device']}: {kind.what} of meshes that differ, each list in one call") as (
        _,
        axes,
    ):
        for place, way in enumerate(ways):
            at = [i + (place - (len(ways) - 1) / 2) * 0.2 for i in range(len(report["rows"]))]
            bars = axes.bar(at, [found[way] for found in report["rows"]], 0.18, label=WAYS[way])
            axes.bar_label(bars, fmt="{:,.0f}", fontsize=8)
        axes.set_xticks(
            range(len(report["rows"])),
            [
                f"{f['meshes']:,} meshes{TOLD.get(f['list'], '')}, {kind.told.format(f[kind.of_each])}\n"
                f"{f['triangles']:,} triangles"
                for f in report["rows"]
            ],
        )
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        plain_ticks(axes.yaxis)
        axes.set_ylabel(f"{kind.what} a second")
        axes.set_title(f"{kind.what.capitalize()} of meshes that differ, each for the first time", loc="left")
        axes.legend()


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--points", type=int, help="scattered points around each mesh, in place of a map")
    parser.add_argument("--lists", nargs="*", default=list(RECORDED), choices=list(LISTS))
    parser.add_argument("--scale", type=float, default=1.0, help="share of the meshes, and of their triangles")
    parser.add_argument("--some", type=int, default=100, help="meshes that the loops take")
    parser.add_argument("--runs", type=int, default=5, help="calls of the whole list in a row")
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args(arguments)
    rows = []
    for name in given.lists:
        count, fewest, most = LISTS[name]
        sizes = max(2, round(given.scale * count)), max(20, int(given.scale * fewest)), max(40, int(given.scale * most))
        cases = list_of(name, *sizes)
        kind, size = (Points, given.points) if given.points else (Maps, given.resolution)
        found = row(name, kind(cases, size, given.device), given.some, given.runs)
        print("  ".join(f"{k} {v:,.1f}" if isinstance(v, float) else f"{k} {v}" for k, v in found.items()), flush=True)
        rows.append(found)
    report = {"machine": describe(given.device), "rows": rows}
    if given.out:
        json_file.write(given.out, report)
        draw(report, given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
