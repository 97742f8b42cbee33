"""Maps of dirty meshes, beside the same maps without signs: what holes, sheets and loose parts cost.

    python -m sdm.bench.dense.dirty --device cuda --resolution 256 --out dirty-cuda.json

Meshes are torn, opened, turned inside out here, or are files (`--meshes`, `--zoo`). A row tells the boundary edges,
milliseconds of the signed map, of the distances alone, of a closed torus of as many triangles and, on a GPU, of stock
Warp (on a CPU also the seconds of all its cores, which do not tell how busy it is otherwise, and which the ratios are
of); how many boxes of voxels of each size were looked at, how many voxels by themselves and in float64, and which share
of all voxels each of these decided; and the wrong signs among random voxels whose winding number, summed up over all
triangles in float64, is further than 1e-3 from one half.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch

from sdm.bench.common import json_file
from sdm.bench.common.figure import drawing
from sdm.bench.common.grids import cube_around
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, load_case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import by_turns, once
from sdm.bench.dense.job import Ours, recorded
from sdm.bench.dense.parts.dirty_cases import generated, of_files
from sdm.bench.dense.parts.signs import unsigned
from sdm.bench.peers.warp import StockWarp, StockWarpSah
from sdm.engine.ops import map_slab
from sdm.kernels.winding import column_sums
from sdm.kernels.winding.looks.count_places import ALONE, BITS, EXACT, LOOKED, STRIDE

# Random voxels whose signs are checked.
CHECKED = 2000
# What decided a voxel: caps being too far for any box to ask; boxes of so many voxels along each edge; its own field;
# the sum over all edges.
DECIDED = ("32^3", "16^3", "8^3", "4^3", "2^3", "voxel", "exact")


def row(case: Case, device: str, resolution: int, runs: int) -> dict[str, Any]:
    """The figures of one mesh."""
    grid = cube_around(case, resolution)
    ours = Ours(case, device)

    def query() -> torch.Tensor:
        return map_slab(ours.vertices[None], ours.faces, ours.index._structure, grid, 0, resolution)[0]

    values = query()[0].cpu().numpy()
    looked = _looked_at(query, values.size)
    gpu = device.startswith("cuda")
    calls: dict[str, Callable[[], Any]] = {"signed": recorded(query)[0] if gpu else query}
    with unsigned():
        query()
        if gpu:
            calls["unsigned"] = recorded(query)[0]
        else:
            calls["unsigned"] = _without_signs(query)
    calls["unsigned"]()
    closed = _closed_map(len(case), device, resolution)
    calls["closed"] = recorded(closed)[0] if gpu else closed
    calls["closed"]()
    times = by_turns(calls, device, runs, 20_000.0)
    signed, alone = times["signed"].ms, times["unsigned"].ms
    found = {
        "mesh": case.name,
        "triangles": len(case),
        "boundary_edges": ours.index._structure.sizes.edges,
        "signed_ms": signed,
        "unsigned_ms": alone,
        "closed_ms": times["closed"].ms,
        "ratio": signed / alone,
        "over_closed": signed / times["closed"].ms,
        "looked_at": looked,
        "wrong_signs": _wrong(case, grid, values, device),
    }
    if not gpu:
        seconds = _cpu_seconds(calls, runs)
        found |= {f"{name}_cpu_s": taken for name, taken in seconds.items()}
        found["ratio"] = seconds["signed"] / seconds["unsigned"]
        found["over_closed"] = seconds["signed"] / seconds["closed"]
    if gpu:
        found["stock_warp_ms"] = min(_stock(peer, case, grid, device) for peer in (StockWarp, StockWarpSah))
    return found


def _closed_map(triangles: int, device: str, resolution: int) -> Callable[[], torch.Tensor]:
    """A call that maps a closed torus of about so many triangles."""
    case = load_case(f"torus-{triangles}")
    ours, grid = Ours(case, device), cube_around(case, resolution)
    return lambda: map_slab(ours.vertices[None], ours.faces, ours.index._structure, grid, 0, resolution)[0]


def _cpu_seconds(calls: dict[str, Callable[[], Any]], turns: int) -> dict[str, float]:
    """Seconds of all cores that each call takes: the least of some turns."""
    least = dict.fromkeys(calls, float("inf"))
    for _ in range(turns):
        for name, call in calls.items():
            begin = time.process_time()
            call()
            least[name] = min(least[name], time.process_time() - begin)
    return least


def _without_signs(query: Callable[[], Any]) -> Callable[[], Any]:
    def call() -> Any:
        with unsigned():
            return query()

    return call


def _looked_at(query: Callable[[], Any], voxels: int) -> dict[str, Any]:
    """Boxes of each size and voxels that a map of one mesh looks at, and the share of voxels that each decides.

    None of a closed one. A voxel in a box of 2^3 is counted to it, if it is not looked at by itself.
    """
    counts: list[np.ndarray] = []

    def watched(plain: Callable[..., Any]) -> Callable[..., None]:
        # A copy, as the scratch that it is in is given back.
        return lambda *inputs: counts.append(plain(*inputs).numpy().copy())

    with (
        mock.patch.object(column_sums, "open_caps", watched(column_sums.open_caps)),
        mock.patch.object(column_sums, "open_caps_by_eights", watched(column_sums.open_caps_by_eights)),
        mock.patch.object(column_sums, "open_edges", watched(column_sums.open_edges)),
        mock.patch.object(column_sums, "open_edges_by_eights", watched(column_sums.open_edges_by_eights)),
    ):
        query()
    if not counts:
        return {}
    total = np.sum(counts, 0)
    levels = list(enumerate(BITS))
    looked = {1 << bits: int(total[STRIDE * n + LOOKED]) for n, bits in levels if bits}
    # Voxels that are still open before boxes of each size; before the first ones, all.
    first = max(size for size, count in looked.items() if count)
    before = [voxels if size > first else min(voxels, count * size**3) for size, count in looked.items()]
    before += [int(total[STRIDE * ALONE + LOOKED]), int(total[EXACT]), 0]
    # Sizes that are not looked at decide nothing.
    for n in range(len(before) - 4, 0, -1):
        if before[n] == 0:
            before[n] = before[n + 1]
    shares = [max(0, one - other) / voxels for one, other in itertools.pairwise(before)]
    return {
        **{f"{size}^3": count for size, count in looked.items() if count},
        "voxels": before[-3],
        "exact": before[-2],
        "shares": dict(zip(DECIDED, shares, strict=True)),
    }


def _wrong(case: Case, grid: Any, values: np.ndarray, device: str) -> int:
    at = np.random.default_rng(1).integers(0, values.size, CHECKED)
    winding = Brute(case.vertices, case.faces, device).winding_number(grid.points().reshape(-1, 3).numpy()[at])
    sure = np.abs(winding - 0.5) > 1e-3
    return int((((values.reshape(-1)[at] < 0) != (winding > 0.5)) & sure & (values.reshape(-1)[at] != 0)).sum())


def _stock(peer: type[StockWarp], case: Case, grid: Any, device: str) -> float:
    stock = peer(device)
    stock.build(case)
    stock.signed_distance_map(grid)
    return min(once(lambda: stock.signed_distance_map(grid), device)[0] for _ in range(2))


def replaced(rows: list[dict[str, Any]], found: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows with the one of the same mesh replaced, or with a new one."""
    if all(each["mesh"] != found["mesh"] for each in rows):
        return [*rows, found]
    return [found if each["mesh"] == found["mesh"] else each for each in rows]


def light_to_dark(count: int) -> list[Any]:
    """So many colours from light to dark."""
    from matplotlib import colormaps

    return list(colormaps["YlGnBu"](np.linspace(0.15, 1.0, count)))


def draw(report: dict[str, Any], path: Path) -> None:
    """Signed over unsigned, mesh by mesh, and the share of voxels that each size of box decides."""
    rows = [found for found in report["rows"] if found["boundary_edges"]]
    told = f"{report['machine']['device']}, {report['resolution']}³: signed maps beside the same meshes' unsigned ones"
    with drawing(path, told) as (figure, left):
        figure.text(0.02, 0.965, "What dirt costs", fontsize=14, fontweight="bold", va="center")
        left.set_position((0.24, 0.145, 0.34, 0.76))
        right = figure.add_axes((0.6, 0.145, 0.38, 0.76))
        places = np.arange(len(rows))[::-1]
        left.barh(places, [found["ratio"] for found in rows])
        left.set_yticks(places, [found["mesh"] for found in rows], fontsize=8)
        left.set_xscale("log")
        at = [1, 2, 3, 5, 10, 20, 50, 100]
        left.set_xticks(at, [str(each) for each in at], minor=False)
        left.minorticks_off()
        left.axvline(3, color="0.6", linewidth=0.8)
        left.set_xlim(0.95, 1.1 * max(3.0, *(found["ratio"] for found in rows)))
        left.set_xlabel("times the unsigned map (line: 3)")
        start = np.zeros(len(rows))
        # From boxes that decide much at once, light, to voxels by themselves, dark.
        shades = light_to_dark(len(DECIDED))
        for name, shade in zip(DECIDED, shades, strict=True):
            share = np.array(
                [found["looked_at"]["shares"].get(name, 0.0) if found["looked_at"] else 0 for found in rows]
            )
            right.barh(places, share, left=start, label=name.replace("^3", "³"), color=shade)
            start += share
        right.set_yticks([])
        right.set_xlabel("share of voxels decided by boxes of")
        right.legend(fontsize=7, ncol=len(DECIDED), loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--resolution", type=int, default=64, help="voxels along each axis")
    parser.add_argument("--meshes", nargs="*", help="names or files instead of all that are known here")
    parser.add_argument("--zoo", type=Path, help="folder of foreign meshes, some of which are taken too")
    parser.add_argument("--only", nargs="*", help="parts of the names of those to take; others stay as --out has them")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    report: dict[str, Any] = {}
    if given.only and given.out and given.out.exists():
        before = json.loads(given.out.read_text())
        rows = [{"commit": before["machine"]["commit"], **each} for each in before["rows"]]
    chosen = map(load_case, given.meshes) if given.meshes else itertools.chain(generated(), of_files(given.zoo))
    for case in chosen:
        if given.only and not any(part in case.name for part in given.only):
            continue
        found = row(case, given.device, given.resolution, given.runs)
        stock = f", stock Warp {found['stock_warp_ms']:.0f}" if "stock_warp_ms" in found else ""
        print(
            f"{case.name}: {found['boundary_edges']} edges, {found['signed_ms']:.3g} ms, without signs "
            f"{found['unsigned_ms']:.3g} ({found['ratio']:.2f} times), {found['over_closed']:.2f} times a closed mesh"
            f"{stock}, wrong signs {found['wrong_signs']}, "
            f"{ {k: v for k, v in found['looked_at'].items() if k != 'shares'} }",
            flush=True,
        )
        machine = describe(given.device)
        rows = replaced(rows, {**found, "commit": machine["commit"]})
        report = {"machine": machine, "resolution": given.resolution, "rows": rows}
        if given.out:
            # After each, as a run may be cut short.
            json_file.write(given.out, report)
    if given.out and report:
        draw(report, given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
