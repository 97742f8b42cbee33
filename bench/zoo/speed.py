"""First maps of foreign meshes, beside stock Warp: what somebody waits for who comes with meshes of their own.

    python -m sdm.bench.zoo.speed FOLDER --device cuda --budget-s 100 --out bench/results/zoo-speed-cuda.json

Each mesh of the folder with 200 triangles or more is measured for the first time at each resolution: our time goes from
vertices and faces on the device to the map, topology and tree included, of a mesh whose counts were never seen. Stock
Warp's is that of its query alone, by the faster of its two trees, the better of two calls. The device is awake and idle
before each call, and kernels were compiled, and the capacity classes of meshes recorded, by other meshes. Values are
checked against a float64 brute force.

What is in the JSON file already stays: with a budget, the command is given again until it says that all is measured.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.dirty_meshes.by_code import half_spheres, sheets, torn, turned
from sdm.bench.common.grids import cube_around
from sdm.bench.common.machine import describe
from sdm.bench.common.markdown import markdown_table
from sdm.bench.common.meshes import Case, load_case
from sdm.bench.common.timing import once
from sdm.bench.dense.job import Job, check_map
from sdm.bench.peers.warp import StockWarp, StockWarpSah
from sdm.bench.zoo.folder import meshes_of
from sdm.bench.zoo.speed_summary import draw, lines, summaries
from sdm.core.device import choose_device
from sdm.errors import FormatError, SDMError, SDMWarning

LEAST = 200
RESOLUTIONS = (64, 256)
# Voxels of each map that are checked.
CHECKED = 256
# Our calls after the first, of which the fastest tells what a repeated one takes: so many that the recording of the
# third is used often enough not to put off those of the meshes after (`sdm.runtime.graphs.graph_cache`).
REPEATED = 14
# A stock query that takes longer is not made again, in milliseconds.
SLOW_MS = 1000.0
# Sizes of the closed and torn meshes that compile and load the kernels, one of each capacity class, and about how many
# edges of a hole the first of the torn ones has; and calls about each, of which the last is a repeated one.
WARM = (500, 3000, 20_000, 50_000, 150_000)
FEW_EDGES = 60
WARM_CALLS = 2


def new_mesh(case: Case, device: str, unused: int) -> sdm.TriangleMesh:
    """The mesh in arrays never seen, on the device, with so many vertices at the end that no face uses.

    Those make its counts new, whatever was measured before.
    """
    vertices = np.concatenate([case.vertices, np.repeat(case.vertices[:1], unused, 0)])
    on_device = torch.from_numpy(vertices).to(device), torch.from_numpy(case.faces).to(device)
    return sdm.TriangleMesh(*on_device, case.name, check=False)


def wake(device: str) -> None:
    """Let an idle GPU come to its clock, and wait until it is idle again."""
    if device.startswith("cuda"):
        numbers = torch.ones(2048, 2048, device=device)
        for _ in range(20):
            numbers = numbers @ numbers * 1e-4
        torch.cuda.synchronize(device)


def undisturbed(call: Callable[[], Any], device: str) -> tuple[float, Any]:
    """`once` without Python's collector of garbage, as in `timeit`: it takes a millisecond, whoever's turn it is."""
    gc.disable()
    try:
        return once(call, device)
    finally:
        gc.enable()


def row(case: Case, device: str, resolution: int, unused: int) -> dict[str, Any]:
    """The figures of one mesh at one resolution; `unused` vertices make its counts new."""
    grid = cube_around(case, resolution)
    mesh = new_mesh(case, device, unused)
    wake(device)
    first, field = undisturbed(lambda: sdm.signed_distance_map(mesh, grid, device=device), device)
    checked = check_map(Job(device, False, 0.0), case, grid, field.values, CHECKED)
    repeated = []
    while len(repeated) < REPEATED and sum(repeated) < SLOW_MS / 2:
        repeated.append(undisturbed(lambda: sdm.signed_distance_map(mesh, grid, device=device), device)[0])
    stock = {peer.builder: stock_ms(peer, case, grid, device) for peer in builders(device)}
    best = min(stock.values())
    return {
        "mesh": case.name,
        "triangles": len(case),
        "resolution": resolution,
        "ambiguous_voxels": field.ambiguous_voxels,
        "first_ms": first,
        "repeated_ms": min(repeated),
        "stock_ms": stock,
        "stock_over_first": best / first,
        "stock_over_repeated": best / min(repeated),
        "wrong": checked["wrong_signs"] + checked["over_limit"],
        "max_error": checked["max_error"],
    }


def builders(device: str) -> tuple[type[StockWarp], ...]:
    """Stock Warp with each of the trees that there are on a device."""
    # On CPUs there is one tree alone.
    return (StockWarp, StockWarpSah) if device.startswith("cuda") else (StockWarpSah,)


def stock_ms(peer: type[StockWarp], case: Case, grid: sdm.Grid, device: str) -> float:
    """Milliseconds of stock Warp's query: the better of two, or one if it is slow."""
    stock = peer(device)
    stock.build(case)
    wake(device)
    times = [once(lambda: stock.signed_distance_map(grid), device)[0]]
    if times[0] < SLOW_MS:
        times.append(once(lambda: stock.signed_distance_map(grid), device)[0])
    return min(times)


def warm_up(device: str, resolutions: Sequence[int]) -> None:
    """Compile and load what maps need: of closed and of torn meshes, sheets and turned faces, small and large."""
    cases = [load_case(f"torus-{size}") for size in WARM]
    plain = [(case.vertices, case.faces) for case in cases]
    dirty = [torn(mesh, share) for mesh in plain for share in (FEW_EDGES / 3 / len(mesh[1]), 0.01, 0.2, 0.5)]
    dirty += [half_spheres(20), sheets(60), *(turned(mesh, 0.5) for mesh in plain[:2])]
    cases += [Case("warm", vertices, faces, frozenset()) for vertices, faces in dirty]
    for case in cases if device.startswith("cuda") else cases[:2]:
        for resolution in resolutions:
            grid, mesh = cube_around(case, resolution), new_mesh(case, device, 0)
            for _ in range(WARM_CALLS):
                sdm.signed_distance_map(mesh, grid, device=device).values.sum().item()
    for peer in builders(device):
        stock_ms(peer, cases[0], cube_around(cases[0], 16), device)


def measure(
    folder: Path, device: str, resolutions: Sequence[int], done: set[tuple[str, int]], budget_s: float
) -> Iterator[dict[str, Any]]:
    """Rows of the meshes that are not `done`, until the budget is used up."""
    began = time.monotonic()
    warm_up(device, resolutions)
    # By twos, as one vertex more would make closed meshes look open.
    for unused, resolution in zip(range(0, 2 * len(resolutions), 2), resolutions, strict=True):
        for case in meshes_of(folder, LEAST):
            if (case.name, resolution) in done:
                continue
            if time.monotonic() - began > budget_s:
                return
            yield row(case, device, resolution, unused)


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 1 if a value of ours was wrong, 2 for a bad request, 3 if the budget left meshes out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="mesh files, or .npz with vertices and faces, also in folders in it")
    parser.add_argument("--device", help="cpu or cuda (default: cuda if there)")
    parser.add_argument("--resolutions", type=int, nargs="+", default=list(RESOLUTIONS), help="voxels along an axis")
    parser.add_argument("--budget-s", type=float, default=float("inf"), help="seconds after which no mesh is begun")
    parser.add_argument("--out", type=Path, help="JSON file to which rows are added; a picture goes beside it")
    given = parser.parse_args(argv)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SDMWarning)
            return _run(given)
    except SDMError as error:
        print(f"sdm: {error}", file=sys.stderr)
        return 2


def _run(given: argparse.Namespace) -> int:
    device = str(choose_device(given.device))
    rows = _earlier(given.out)
    done = {(found["mesh"], found["resolution"]) for found in rows}
    report: dict[str, Any] = {"command": "python -m sdm.bench.zoo.speed", "rows": rows}
    for found in measure(given.folder, device, given.resolutions, done, given.budget_s):
        rows.append(found)
        _print_row(found)
        if given.out:
            json_file.write(given.out, report)
    report |= {"machine": describe(device), "summary": summaries(rows)}
    wanted = {(case.name, resolution) for case in meshes_of(given.folder, LEAST) for resolution in given.resolutions}
    left = wanted - {(found["mesh"], found["resolution"]) for found in rows}
    table = lines(report["summary"])
    if rows:
        print("\n" + markdown_table(table[0], table[1:]))
    print(f"{len(left)} of {len(wanted)} are left: give the command again" if left else "all is measured")
    if given.out and rows:
        json_file.write(given.out, report)
        draw(report, given.out.with_suffix(".png"))
    return 3 if left else int(any(found["wrong"] for found in rows))


def _print_row(found: dict[str, Any]) -> None:
    stock = ", ".join(f"{name} {ms:.2f}" for name, ms in found["stock_ms"].items())
    print(
        f"{found['mesh']} {found['triangles']} at {found['resolution']}^3: first {found['first_ms']:.2f} ms, repeated "
        f"{found['repeated_ms']:.2f}, stock {stock}: {found['stock_over_first']:.2f} times"
        + (f", {found['wrong']} WRONG" if found["wrong"] else ""),
        flush=True,
    )


def _earlier(out: Path | None) -> list[dict[str, Any]]:
    if out is None or not out.is_file():
        return []
    try:
        return list(json.loads(out.read_text())["rows"])
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{out} is there and holds no results of this benchmark: give another file") from error


if __name__ == "__main__":
    sys.exit(main())
