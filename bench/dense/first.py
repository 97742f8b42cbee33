"""First calls and repeated ones: maps of meshes whose numbers of vertices and faces were never seen before.

    python -m sdm.bench.dense.first --device cuda --out first-cuda.json

Each mesh is made `--variants` times with other counts, by new vertices in the middle of some of its faces. A first call
is the first with such counts, the device idle before it, kernels loaded, vertices and faces on the device; a repeated
one has other vertices and faces in memory of their own, of counts seen often. A mesh of other counts comes before those
that are timed: `cold_ms`, a call for which its capacity class is recorded. A row tells milliseconds of both by CUDA
events around the call, structure and topology counted, and microseconds until the call returns to the host. Two
maps of each mesh, from a first and from a repeated call, have to be equal bit for bit.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.figure import MARKERS, SPARE, drawing, log_axes, plain_ticks
from sdm.bench.common.grids import cube_around
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, load_case, missing_note
from sdm.bench.common.timing import once
from sdm.runtime import graphs
from sdm.viz.style import PALETTE

MESHES = ("torus-1000", "torus-5000", "torus-20000", "torus-100000", "rocker-arm", "nefertiti", "stanford-bunny")
RESOLUTIONS = (32, 64, 128, 256, 512)
# Faces that the first variant splits; each further one splits more.
FEWEST_SPLIT = 3
# Repeated calls before those that are timed: enough for a recording.
WARM = graphs.CALLS + 2


def split(case: Case, count: int) -> Case:
    """The same surface with `count` of its faces split in three at their middles."""
    rng = np.random.default_rng(count)
    chosen = rng.permutation(len(case))[:count]
    middles = case.vertices[case.faces[chosen]].astype(np.float64).mean(1).astype(np.float32)
    new = len(case.vertices) + np.arange(len(chosen), dtype=np.int32)
    a, b, c = case.faces[chosen].T
    kept = np.delete(case.faces, chosen, axis=0)
    parts = [np.stack(corners, 1) for corners in ((a, b, new), (b, c, new), (c, a, new))]
    faces = np.concatenate([kept, *parts]).astype(np.int32)
    return Case(case.name, np.concatenate([case.vertices, middles]), faces, case.tags)


def timed(call: Callable[[], Any], device: str) -> tuple[float, float, Any]:
    """Milliseconds of a call, microseconds until it returns, and its result; the device is idle before."""
    host = 0.0

    def watched() -> Any:
        nonlocal host
        begin = time.perf_counter()
        found = call()
        host = 1e6 * (time.perf_counter() - begin)
        return found

    ms, found = once(watched, device)
    return ms, host, found


def fresh(case: Case, device: str) -> sdm.TriangleMesh:
    """The mesh in new memory of the device."""
    vertices, faces = torch.from_numpy(case.vertices).to(device), torch.from_numpy(case.faces).to(device)
    return sdm.TriangleMesh(vertices, faces, case.name, check=False)


def row(case: Case, device: str, resolution: int, variants: int, runs: int, split_before: int = 0) -> dict[str, Any]:
    """The figures of one mesh on one grid, of meshes with more than `split_before` of its faces split."""
    grid = cube_around(case, resolution)
    graphs.clear()
    firsts, last = [], case
    values = torch.empty(0)
    for number in range(1 + variants):
        last = split(case, split_before + FEWEST_SPLIT + number)
        mesh = fresh(last, device)
        ms, us, field = timed(lambda mesh=mesh: sdm.signed_distance_map(mesh, grid, device=device), device)
        firsts.append((ms, us))
        values = field.values
    for _ in range(WARM if device.startswith("cuda") else 0):
        sdm.signed_distance_map(fresh(last, device), grid, device=device)
    repeated = []
    for _ in range(runs):
        mesh = fresh(last, device)
        ms, us, field = timed(lambda mesh=mesh: sdm.signed_distance_map(mesh, grid, device=device), device)
        repeated.append((ms, us))
    # On a GPU with the recording that serves meshes of about this size, and after.
    cold, first, again = _medians(firsts[:1]), _medians(firsts[1:]), _medians(repeated)
    return {
        "mesh": case.name,
        "triangles": len(case),
        "resolution": resolution,
        "first_ms": first[0],
        "first_host_us": first[1],
        "first_slowest_ms": max(ms for ms, _ in firsts[1:]),
        "cold_ms": cold[0],
        "repeated_ms": again[0],
        "repeated_host_us": again[1],
        "ratio": first[0] / again[0],
        "equal": bool(torch.equal(values, field.values)),
    }


def _medians(found: list[tuple[float, float]]) -> tuple[float, float]:
    return statistics.median(ms for ms, _ in found), statistics.median(us for _, us in found)


def draw(report: dict[str, Any], path: Path) -> None:
    """Milliseconds against voxels along an axis: first calls as lines, repeated ones dashed."""
    from matplotlib.ticker import LogLocator

    with drawing(path, f"{report['machine']['device']}: first call and, dashed, repeated call") as (_, axes):
        hues = (*PALETTE, *reversed(SPARE))
        sizes: list[int] = sorted({found["resolution"] for found in report["rows"]})
        for number, name in enumerate(dict.fromkeys(found["mesh"] for found in report["rows"])):
            rows = [found for found in report["rows"] if found["mesh"] == name]
            own = [found["resolution"] for found in rows]
            hue, marker = hues[number % len(hues)], MARKERS[number % len(MARKERS)]
            axes.plot(own, [found["first_ms"] for found in rows], "-", marker=marker, color=hue, label=name)
            axes.plot(own, [found["repeated_ms"] for found in rows], "--", color=hue)
        log_axes(axes)
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.minorticks_off()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        plain_ticks(axes.yaxis)
        axes.set_xlabel("voxels along each axis")
        axes.set_ylabel("milliseconds of a map")
        axes.set_title("A mesh's first map and its repeated ones", x=0.0, ha="left")
        axes.legend(fontsize=8)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--resolutions", type=int, nargs="*", default=list(RESOLUTIONS))
    parser.add_argument("--meshes", nargs="*", default=list(MESHES), help="names, torus-N, or files")
    parser.add_argument("--variants", type=int, default=7, help="first calls of each mesh and grid")
    parser.add_argument("--runs", type=int, default=7, help="repeated calls of each")
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args()
    rows = []
    print(f"{'':30}{'first':>20}{'repeated':>20}\n{'':30}" + 2 * f"{'ms':>10}{'host us':>10}" + f"{'ratio':>8}")
    for name in given.meshes:
        if (note := missing_note(name)) is not None:
            print(note)
            continue
        case = load_case(name)
        # Kernels are loaded, and memory is taken.
        sdm.signed_distance_map(fresh(split(case, FEWEST_SPLIT - 1), given.device), given.resolutions[0])
        for number, resolution in enumerate(given.resolutions):
            # At each with counts that were not seen at another one, either.
            seen = number * (1 + given.variants)
            found = row(case, given.device, resolution, given.variants, given.runs, seen)
            print(
                f"{name:20}{resolution:>8}^3"
                f"{found['first_ms']:>10.3f}{found['first_host_us']:>10.0f}"
                f"{found['repeated_ms']:>10.3f}{found['repeated_host_us']:>10.0f}{found['ratio']:>8.2f}"
                + ("" if found["equal"] else "  the maps differ"),
                flush=True,
            )
            rows.append(found)
    report = {"machine": describe(given.device), "rows": rows}
    if given.out:
        json_file.write(given.out, report)
        draw(report, given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
