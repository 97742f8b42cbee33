"""The accuracy report: every mesh against the float64 brute force. `python -m sdm.bench.dense.accuracy --help`.

For each mesh: points everywhere, near the surface, on it, in line with edges and far away through
`sdm.signed_distance`, the same with `return_closest`, and random voxels of a grid, and of a turned grid of unequal
spacing, through `sdm.signed_distance_map`. Limits: a distance is off by at most 4 roundings
(`sdm.bench.common.correctness.rounding`), the closest point is at that distance, on the face that is named and at its
barycentric coordinates to within the same, and no sign is wrong where the winding number is further than 1e-3 from one
half and the distance above 4 roundings.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

import sdm
from sdm.bench.common import query_points as sampling
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.correctness import LIMIT, Tally, compare, rounding
from sdm.bench.common.grids import cube_around, turned_around
from sdm.bench.common.json_file import put, write
from sdm.bench.common.machine import describe
from sdm.bench.common.markdown import accuracy_markdown
from sdm.bench.common.meshes import Case, dirty_names, load_case, missing_note, names
from sdm.bench.common.oracles.brute_force import Brute
from sdm.engine.plan_override import plan_override

SHARES = {"uniform": 0.3, "near": 0.3, "surface": 0.12, "in line": 0.1, "far": 0.06, "voxels": 0.08, "turned": 0.04}
# Larger meshes get fewer points, so that the brute force stays within seconds on a GPU.
FULL_COUNT_TRIANGLES = 200_000
MILLION = "torus-1000000"


def check(case: Case, points: int, resolution: int, device: str) -> dict[str, Any]:
    """Everything about one mesh, for the report."""
    start = time.perf_counter()
    total = points if len(case) <= FULL_COUNT_TRIANGLES else points * FULL_COUNT_TRIANGLES // len(case)
    mesh = sdm.TriangleMesh(case.vertices, case.faces, case.name)
    brute = Brute(case.vertices, case.faces, device)
    kinds: dict[str, Tally] = {}
    hits = {"distance": 0.0, "face": 0.0, "barycentric": 0.0}
    seconds = {"sdm": 0.0, "brute force": 0.0}

    def measure(kind: str, at: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        begin = time.perf_counter()
        distance, _, _ = brute.distance(at)
        winding = brute.winding_number(at)
        seconds["brute force"] += time.perf_counter() - begin
        kinds[kind] = compare(case, at, values, distance, winding)
        return distance, winding

    for kind, sample in sampling.KINDS.items():
        at = sample(case, round(SHARES[kind] * total))
        begin = time.perf_counter()
        values = sdm.signed_distance(mesh, at, device=device).cpu().numpy()
        again, hit = sdm.signed_distance(mesh, at, return_closest=True, device=device)
        found = tuple(x.cpu().numpy() for x in (hit.points, hit.faces, hit.barycentric))
        seconds["sdm"] += time.perf_counter() - begin
        distance, winding = measure(kind, at, values)
        kinds[f"{kind}, closest"] = compare(case, at, again.cpu().numpy(), distance, winding)
        for what, error in _hit_errors(case, brute, at, distance, *found).items():
            hits[what] = max(hits[what], error)

    straight, turned = cube_around(case, resolution), turned_around(case, resolution)
    for kind, grid, method in (
        ("voxels", straight, "cells"),
        ("voxels, search", straight, "search"),
        ("turned", turned, "auto"),
    ):
        begin = time.perf_counter()
        with plan_override(method=method):
            values = sdm.signed_distance_map(mesh, grid, device=device).numpy()
        seconds["sdm"] += time.perf_counter() - begin
        share = SHARES[kind.split(",")[0]]
        chosen = sampling.generator(case, kind).integers(0, grid.size, round(share * total))
        measure(kind, grid.points().numpy().reshape(-1, 3)[chosen], values.reshape(-1)[chosen])

    fine = all(t.fine for t in kinds.values()) and all(e <= LIMIT for e in hits.values())
    return {
        "fine": fine,
        "triangles": len(case),
        "tags": sorted(case.tags),
        "points": sum(kinds[kind].points for kind in SHARES),
        "kinds": {kind: tally.as_dict() for kind, tally in kinds.items()},
        "closest_point_errors": {k: v if np.isfinite(v) else None for k, v in hits.items()},
        "seconds": {k: round(v, 2) for k, v in (*seconds.items(), ("all", time.perf_counter() - start))},
    }


def _hit_errors(
    case: Case,
    brute: Brute,
    at: np.ndarray,
    distance: np.ndarray,
    closest: np.ndarray,
    face: np.ndarray,
    barycentric: np.ndarray,
) -> dict[str, float]:
    """In roundings: is the closest point at that distance, on that face, at these barycentric coordinates?"""
    if face.min() < 0 or face.max() >= len(case) or not (np.isfinite(closest).all() and np.isfinite(barycentric).all()):
        return {"distance": np.inf, "face": np.inf, "barycentric": np.inf}
    unit = rounding(case, at)
    corner = case.vertices.astype(np.float64)[case.faces[face]]
    weights = barycentric.astype(np.float64)
    length = np.linalg.norm(at.astype(np.float64) - closest, axis=1)
    placed = np.linalg.norm(np.einsum("nk,nki->ni", weights, corner) - closest, axis=1)
    # Weights below zero would name a point outside the face.
    outside = np.maximum(-weights.min(1), 0) * np.abs(corner - corner[:, :1]).max((1, 2))
    return {
        "distance": float((np.abs(length - distance) / unit).max()),
        "face": float((brute.distance_to_face(closest, face) / unit).max()),
        "barycentric": float((np.maximum(placed, outside) / unit).max()),
    }


def main(argv: list[str] | None = None) -> int:
    """Run the report; 1 if any limit is broken, else 0."""
    options = _options(argv)
    out: Path = options.out
    made_on = describe(options.device)
    setting = {"points": options.points, "resolution": options.resolution}
    results: dict[str, Any] = {}
    if options.resume and out.is_file():
        old = json.loads(out.read_text())
        # Clocks are those of the moment.
        same = {key: value for key, value in {**made_on, **setting}.items() if key != "clocks"}
        if all(old.get(key) == value for key, value in same.items()):
            results = old["meshes"]
    left_out = [note for name in options.meshes if (note := missing_note(name)) is not None]
    todo = [name for name in options.meshes if missing_note(name) is None and name not in results]
    for note in left_out:
        print(note, flush=True)
    jobs = [(name, options.points, options.resolution, options.device) for name in todo]
    for number, (name, result) in enumerate(_checked(jobs, options.processes), 1):
        results[name] = result
        print(f"[{number}/{len(todo)}] {_line(name, result)}", flush=True)
        # In the order of the list, whichever process ends first.
        meshes = {name: results[name] for name in [*options.meshes, *results] if name in results}
        _write(out, {**made_on, **setting, "limit": LIMIT, "left_out": left_out, "meshes": meshes})
    broken = [name for name, result in results.items() if not result["fine"]]
    print(f"{out} and {out.with_suffix('.md').name} written: {len(results)} meshes, {len(broken)} break a limit")
    return 1 if broken or not results else 0


def _checked(jobs: list[tuple[str, int, int, str]], processes: int) -> Iterable[tuple[str, dict[str, Any]]]:
    """Each mesh's name and result as it ends, of this process or of several with one thread each."""
    if processes == 1:
        yield from map(_check_job, jobs)
        return
    # Read as a process imports its libraries.
    os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "SDM_NUM_THREADS": "1"}
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap_unordered(_check_job, jobs)


def _check_job(job: tuple[str, int, int, str]) -> tuple[str, dict[str, Any]]:
    name, points, resolution, device = job
    try:
        return name, check(load_case(name), points, resolution, device)
    except Exception as error:  # noqa: BLE001 - whatever fails belongs in the report
        traceback.print_exc()
        return name, {"fine": False, "failed": f"{type(error).__name__}: {error}"}


def _options(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m sdm.bench.dense.accuracy", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "--device", default="cuda" if _has_cuda() else "cpu", help="cpu or cuda (default: what is there)"
    )
    parser.add_argument("--points", type=int, help="points for each mesh (default: 1000000 on a GPU, 20000 on a CPU)")
    parser.add_argument(
        "--resolution", type=int, help="voxels along a grid's axis (default: 128 on a GPU, 64 on a CPU)"
    )
    parser.add_argument("--meshes", nargs="+", metavar="MESH", help="names, torus-N or files (default: all)")
    parser.add_argument("--out", type=Path, help="JSON file; a .md beside it (default: bench/results/accuracy-DEVICE)")
    parser.add_argument("--processes", type=int, default=1, help="that many meshes at once, each in a process")
    parser.add_argument("--resume", action="store_true", help="keep the file's results of the same commit and machine")
    options = parser.parse_args(argv)
    gpu = options.device.startswith("cuda")
    options.points = options.points or (1_000_000 if gpu else 20_000)
    options.resolution = options.resolution or (128 if gpu else 64)
    options.meshes = options.meshes or [*names(), *dirty_names(), *([MILLION] if gpu else [])]
    options.out = options.out or results_folder() / f"accuracy-{options.device.split(':')[0]}.json"
    return options


def _has_cuda() -> bool:
    import torch

    return torch.cuda.is_available()


def _line(name: str, result: dict[str, Any]) -> str:
    if "failed" in result:
        return f"{name}: {result['failed']}"
    worst = max((t["max_error"] if t["max_error"] is not None else np.inf) for t in result["kinds"].values())
    wrong = sum(t["wrong_signs"] for t in result["kinds"].values())
    verdict = "" if result["fine"] else "  BREAKS A LIMIT"
    took = ", ".join(f"{what} {value:.1f} s" for what, value in result["seconds"].items())
    return f"{name}: {result['points']} points, {worst:.2f} roundings, {wrong} wrong signs ({took}){verdict}"


def _write(out: Path, report: dict[str, Any]) -> None:
    write(out, report)
    put(out.with_suffix(".md"), accuracy_markdown(report))


if __name__ == "__main__":
    sys.exit(main())
