"""Maps of dirty meshes, beside the same maps without signs: what holes, sheets and loose parts cost.

    python -m sdm.bench.dense.dirty --device cuda --resolution 256 --out dirty-cuda.json

Meshes are torn, opened, turned inside out here, or are files (`--meshes`). A row tells the boundary edges, milliseconds
of the signed map, of the distances alone and, on a GPU, of stock Warp; how many boxes of voxels were looked at by each
size, how many voxels in float64; and the wrong signs among random voxels whose winding number, summed up over all
triangles in float64, is further than 1e-3 from one half.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.common import json_file
from sdm.bench.common.figure import drawing, log_axes
from sdm.bench.common.grids import cube_around
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, load_case, sphere
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.timing import by_turns, once
from sdm.bench.dense.job import Ours, recorded
from sdm.bench.dense.parts.signs import unsigned
from sdm.bench.peers.warp import StockWarp, StockWarpSah
from sdm.engine.ops import map_slab
from sdm.kernels.winding import column_sums, open_caps

TORUS = "torus-20000"
TORN, SPHERES = (0.01, 0.03, 0.1, 0.3), (10, 100)
# Random voxels whose signs are checked.
CHECKED = 2000
OPEN = frozenset(("open",))


def torn(case: Case, share: float) -> Case:
    """The mesh without a share of its faces, anywhere."""
    kept = np.random.default_rng(0).random(len(case)) >= share
    return Case(f"{case.name} less {100 * share:.0f} %", case.vertices, case.faces[kept], OPEN)


def half_turned(case: Case) -> Case:
    """The mesh with half of its faces inside out."""
    faces = case.faces.copy()
    turned = np.random.default_rng(0).random(len(faces)) < 0.5
    faces[turned] = faces[turned][:, ::-1]
    return Case(f"{case.name}, half its faces turned", case.vertices, faces, OPEN)


def half_spheres(count: int) -> Case:
    """Open bowls of one size, here and there."""
    vertices, faces = sphere(15)
    faces = faces[(vertices[faces][:, :, 2] > -1e-6).all(1)]
    rng = np.random.default_rng(0)
    places = [0.1 * vertices @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + rng.uniform(-1, 1, 3) for _ in range(count)]
    index = [faces + len(vertices) * number for number in range(count)]
    vertices, faces = np.concatenate(places).astype(np.float32), np.concatenate(index).astype(np.int32)
    return Case(f"{count} half spheres", vertices, faces, OPEN)


def cases(files: list[str]) -> Iterator[Case]:
    """Dirty meshes, after the clean one that they are made of."""
    clean = load_case(TORUS)
    yield clean
    for share in TORN:
        yield torn(clean, share)
    yield half_turned(clean)
    for count in SPHERES:
        yield half_spheres(count)
    for file in files:
        yield load_case(file)


def row(case: Case, device: str, resolution: int, runs: int) -> dict[str, Any]:
    """The figures of one mesh."""
    grid = cube_around(case, resolution)
    ours = Ours(case, device)

    def query() -> torch.Tensor:
        return map_slab(ours.vertices[None], ours.faces, ours.index._structure, grid, 0, resolution)[0]

    values = query()[0].cpu().numpy()
    looked = _looked_at(query)
    gpu = device.startswith("cuda")
    calls: dict[str, Callable[[], Any]] = {"signed": recorded(query)[0] if gpu else query}
    with unsigned():
        query()
        if gpu:
            calls["unsigned"] = recorded(query)[0]
        else:
            calls["unsigned"] = _without_signs(query)
    calls["unsigned"]()
    times = by_turns(calls, device, runs, 20_000.0)
    found = {
        "mesh": case.name,
        "triangles": len(case),
        "boundary_edges": ours.index._structure.sizes.edges,
        "signed_ms": times["signed"].ms,
        "unsigned_ms": times["unsigned"].ms,
        "ratio": times["signed"].ms / times["unsigned"].ms,
        "looked_at": looked,
        "wrong_signs": _wrong(case, grid, values),
    }
    if gpu:
        found["stock_warp_ms"] = min(_stock(peer, case, grid, device) for peer in (StockWarp, StockWarpSah))
    return found


def _without_signs(query: Callable[[], Any]) -> Callable[[], Any]:
    def call() -> Any:
        with unsigned():
            return query()

    return call


def _looked_at(query: Callable[[], Any]) -> dict[str, int]:
    """Boxes of each size and voxels that a map of one mesh looks at: none of a closed one."""
    counts: list[np.ndarray] = []
    plain = column_sums.open_caps

    def spy(*inputs: Any) -> Any:
        counts.append(plain(*inputs).numpy())
        return None

    column_sums.open_caps = spy  # type: ignore[assignment]
    try:
        query()
    finally:
        column_sums.open_caps = plain
    if not counts:
        return {}
    total = np.sum(counts, 0)
    boxes = {f"{size}^3": level for level, size in enumerate((*open_caps.SIZES, open_caps.PIECE)) if level}
    return {
        **{name: int(total[open_caps.STRIDE * level + open_caps.LENGTH]) for name, level in boxes.items()},
        "points": int(total[open_caps.POINTS]),
        "exact": int(total[open_caps.EXACT]),
    }


def _wrong(case: Case, grid: Any, values: np.ndarray) -> int:
    at = np.random.default_rng(1).integers(0, values.size, CHECKED)
    winding = Brute(case.vertices, case.faces).winding_number(grid.points().reshape(-1, 3).numpy()[at])
    sure = np.abs(winding - 0.5) > 1e-3
    return int((((values.reshape(-1)[at] < 0) != (winding > 0.5)) & sure & (values.reshape(-1)[at] != 0)).sum())


def _stock(peer: type[StockWarp], case: Case, grid: Any, device: str) -> float:
    stock = peer(device)
    stock.build(case)
    stock.signed_distance_map(grid)
    return min(once(lambda: stock.signed_distance_map(grid), device)[0] for _ in range(2))


def draw(report: dict[str, Any], path: Path) -> None:
    """Ratio of signed to unsigned against boundary edges."""
    with drawing(path, f"{report['machine']['device']}, {report['resolution']}^3") as (_, axes):
        rows = [found for found in report["rows"] if found["boundary_edges"]]
        axes.plot([r["boundary_edges"] for r in rows], [r["ratio"] for r in rows], "o")
        for found in rows:
            axes.annotate(found["mesh"], (found["boundary_edges"], found["ratio"]), fontsize=8)
        axes.set_xlabel("boundary edges")
        axes.set_ylabel("signed map / distances alone")
        log_axes(axes)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--resolution", type=int, default=64, help="voxels along each axis")
    parser.add_argument("--meshes", nargs="*", default=[], help="files of dirty meshes")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args()
    rows = []
    for case in cases(given.meshes):
        found = row(case, given.device, given.resolution, given.runs)
        stock = f", stock Warp {found['stock_warp_ms']:.0f}" if "stock_warp_ms" in found else ""
        print(
            f"{case.name}: {found['boundary_edges']} edges, {found['signed_ms']:.3g} ms, without signs "
            f"{found['unsigned_ms']:.3g} ({found['ratio']:.2f} times){stock}, wrong signs {found['wrong_signs']}, "
            f"{found['looked_at']}",
            flush=True,
        )
        rows.append(found)
    report = {
        "machine": describe(given.device),
        "resolution": given.resolution,
        "rows": rows,
    }
    if given.out:
        json_file.write(given.out, report)
        draw(report, given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
