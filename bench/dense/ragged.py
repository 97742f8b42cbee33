"""Meshes that differ, in one call, beside single calls and a loop over stock Warp.

    python -m sdm.bench.dense.ragged --device cuda --out ragged-cuda.json

Three lists of shapes, no two alike: `alike`, 64 closed ones of about 20,000 triangles, `wide`, 1,000 of 1,000 to
100,000, evenly over the logarithm, and `torn`, 64 of about 20,000 of which half miss 0.1 to 30 % of their faces. Each
is made into maps of `--resolution` voxels an axis around each mesh: by one call of `signed_distance_maps`, by a loop
over `signed_distance_map`, and by a loop over stock Warp's query with either of its builders. Vertices and faces are on
the device and were never seen before by the call that is timed. Ours counts everything: `joint` is `--runs` calls in a
row, `joint_one_call` one from an idle device on. Of stock the queries are timed alone, and with builds. The loops take
`--some` of the meshes, evenly chosen.
Before that all maps are compared: bit for bit with single calls, and at random voxels with a float64 brute force.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.correctness import compare, voxel_centres
from sdm.bench.common.dirty_meshes.by_code import torn
from sdm.bench.common.figure import drawing
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, sphere, torus
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import once
from sdm.bench.peers.warp import StockWarp, StockWarpSah
from sdm.runtime import graphs

LISTS = {"alike": (64, 16_000, 24_000), "wide": (1000, 1_000, 100_000), "torn": (64, 16_000, 24_000)}
# Shares of the faces that torn ones miss.
LEAST_TORN, MOST_TORN = 0.001, 0.3
CHECKED_VOXELS = 40
# Names in the picture: of the ways to make maps, and what is odd about a list.
WAYS = {"joint": "one call", "single": "a call each", "stock_lbvh": "stock Warp, LBVH", "stock_sah": "stock Warp, SAH"}
TOLD = {"torn": ", half of them torn"}


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
    if name == "torn":
        shares = np.exp(np.linspace(np.log(LEAST_TORN), np.log(MOST_TORN), count))
        cases[::2] = [_torn(case, float(share)) for case, share in zip(cases[::2], shares[::2], strict=True)]
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


def check(cases: Sequence[Case], maps: Sequence[sdm.SDM], device: str) -> dict[str, Any]:
    """Maps that differ from those of single calls, and errors at random voxels."""
    different, worst, wrong = 0, 0.0, 0
    for mesh, found in zip(fresh(cases, device), maps, strict=True):
        alone = sdm.signed_distance_map(mesh, found.grid, device=device)
        different += not torch.equal(alone.values, found.values)
    for case, found in list(zip(cases, maps, strict=True))[:: max(1, len(cases) // 8)]:
        which = np.random.default_rng(0).choice(found.values.numel(), CHECKED_VOXELS, replace=False)
        points = voxel_centres(found.grid, which)
        brute = Brute(case.vertices, case.faces, device)
        values = found.numpy().reshape(-1)[which]
        tally = compare(case, points, values, brute.distance(points)[0], brute.winding_number(points))
        worst, wrong = max(worst, tally.max_error), wrong + tally.wrong_signs
    return {"different_from_single": different, "max_error": worst, "wrong_signs": wrong}


def seconds(call: Callable[[], Any], device: str) -> float:
    """Of one call, with the device idle before and waited for after."""
    return once(call, device)[0] / 1e3


def stock_rates(peer: StockWarp, cases: Sequence[Case], grids: Sequence[sdm.Grid], device: str) -> tuple[float, float]:
    """Seconds of queries and of builds, one mesh after the other."""
    built, asked = 0.0, 0.0
    for case, grid in zip(cases, grids, strict=True):
        built += seconds(lambda case=case: peer.build(case), device)
        peer.prepare(grid)
        asked += seconds(lambda grid=grid: peer.signed_distance_map(grid), device)
    return asked, built


def row(name: str, cases: list[Case], resolution: int, device: str, some: int, runs: int) -> dict[str, Any]:
    """The figures of one list."""
    grids = [around(case, resolution) for case in cases]
    maps = sdm.signed_distance_maps(fresh(cases, device), grids, device=device)
    checked = check(cases, maps, device)
    del maps

    def joint(calls: int) -> float:
        """Maps a second of so many calls in a row, the device idle before the first and waited for after the last."""
        lists = [fresh(cases, device) for _ in range(calls)]

        def call() -> None:
            for meshes in lists:
                sdm.signed_distance_maps(meshes, grids, device=device)

        return calls * len(cases) / seconds(call, device)

    in_a_row, alone = joint(runs), max(joint(1) for _ in range(2))
    chosen = range(0, len(cases), max(1, len(cases) // some))
    few, few_grids = [cases[i] for i in chosen], [grids[i] for i in chosen]
    graphs.clear()
    meshes = fresh(few, device)
    single = sum(
        seconds(lambda mesh=mesh, grid=grid: sdm.signed_distance_map(mesh, grid, device=device), device)
        for mesh, grid in zip(meshes, few_grids, strict=True)
    )
    found = {
        "list": name,
        "meshes": len(cases),
        "triangles": int(sum(map(len, cases))),
        "resolution": resolution,
        "joint": in_a_row,
        "joint_one_call": alone,
        "single": len(few) / single,
        **checked,
    }
    for peer in (StockWarp(device), *([StockWarpSah(device)] if device.startswith("cuda") else [])):
        peer.build(few[0])
        peer.prepare(few_grids[0])
        peer.signed_distance_map(few_grids[0])
        asked, built = stock_rates(peer, few, few_grids, device)
        key = "sah" if isinstance(peer, StockWarpSah) or device == "cpu" else "lbvh"
        found[f"stock_{key}"] = len(few) / asked
        found[f"stock_{key}_built"] = len(few) / (asked + built)
    return found


def draw(report: dict[str, Any], path: Path) -> None:
    """Maps a second of each way, as bars for each list."""
    ways = [key for key in WAYS if key in report["rows"][0]]
    with drawing(path, f"{report['machine']['device']}: maps of meshes that differ, each list in one call") as (
        _,
        axes,
    ):
        for place, way in enumerate(ways):
            at = [i + (place - (len(ways) - 1) / 2) * 0.2 for i in range(len(report["rows"]))]
            bars = axes.bar(at, [found[way] for found in report["rows"]], 0.18, label=WAYS[way])
            axes.bar_label(bars, fmt="%.0f", fontsize=8)
        axes.set_xticks(
            range(len(report["rows"])),
            [
                f"{f['meshes']:,} meshes{TOLD.get(f['list'], '')}, {f['resolution']}^3\n{f['triangles']:,} triangles"
                for f in report["rows"]
            ],
        )
        axes.set_yscale("log")
        axes.set_ylabel("maps a second")
        axes.set_title("Maps of meshes that differ, each for the first time", loc="left")
        axes.legend()


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--lists", nargs="*", default=list(LISTS), choices=list(LISTS))
    parser.add_argument("--scale", type=float, default=1.0, help="share of the meshes, and of their triangles")
    parser.add_argument("--some", type=int, default=100, help="meshes that the loops take")
    parser.add_argument("--runs", type=int, default=5, help="calls of the whole list in a row")
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args(arguments)
    rows = []
    for name in given.lists:
        count, fewest, most = LISTS[name]
        sizes = max(2, round(given.scale * count)), max(20, int(given.scale * fewest)), max(40, int(given.scale * most))
        found = row(name, list_of(name, *sizes), given.resolution, given.device, given.some, given.runs)
        print("  ".join(f"{k} {v:,.1f}" if isinstance(v, float) else f"{k} {v}" for k, v in found.items()), flush=True)
        rows.append(found)
    report = {"machine": describe(given.device), "rows": rows}
    if given.out:
        json_file.write(given.out, report)
        draw(report, given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
