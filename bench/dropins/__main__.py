"""Drop-in replacements beside the originals: time, wrong signs, errors.

    python -m sdm.bench.dropins [--points 4000] [--meshes torus-20000 ...] [--runs 15] [--out FILE.json]

Half of the points are anywhere in a box around the mesh, half near its surface. True distances and signs are those of a
float64 brute force; a sign is wrong where the winding number is further than 0.05 from a half and says otherwise. Each
call starts from arrays, so that what is built for a mesh counts. Each is made once before it is timed, so that kernels
are compiled by then, and afterwards theirs and ours take turns: the least of each, as the machine may be busy, and how
far the slowest is from it in percent. Calls of seconds take fewer turns. CPU seconds are those of all threads.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, load_case, missing_note
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.query_points import near, uniform
from sdm.bench.dropins.calls import Call, pairs

MESHES = (
    "torus-20000",
    "overlapping shells",
    "hollow sphere",
    "needle box",
    "filled t-junctions",
    "far from the origin",
    "spot",
    "rocker-arm",
    "stanford-bunny",
    "beast",
)
# Seconds after which no further turn begins.
MOST_SECONDS = 5.0
# Winding numbers this near to a half say nothing.
UNSURE = 0.05
LIBRARIES = ("trimesh", "open3d", "libigl", "mesh-to-sdf", "rtree", "embreex", "warp-lang", "torch", "numpy")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=4000)
    parser.add_argument("--meshes", nargs="+", default=list(MESHES))
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    calls, left = pairs()
    result: dict[str, Any] = {"machine": describe("cpu", LIBRARIES), "points": options.points, "cases": []}
    result["left_out"] = left + [note for name in options.meshes if (note := missing_note(name))]
    for note in result["left_out"]:
        print(note)
    for name in options.meshes:
        if missing_note(name) is not None:
            continue
        case = load_case(name)
        points = np.concatenate([make(case, options.points // 2) for make in (uniform, near)]).astype(np.float64)
        brute = Brute(case.vertices, case.faces, "cpu")
        truth, winding = brute.distance(points)[0], brute.winding_number(points)
        for library, both in calls.items():
            row: dict[str, Any] = {"mesh": name, "triangles": len(case), "library": library}
            row |= measured(
                dict(zip(("theirs", "ours"), both, strict=True)), case, points, truth, winding, options.runs
            )
            result["cases"].append(row)
            print(f"{name:20} {library:42}", *(text(whose, row[whose]) for whose in ("theirs", "ours")), flush=True)
            if options.out is not None:
                write(options.out, result)


def measured(
    calls: dict[str, Call], case: Case, points: np.ndarray, truth: np.ndarray, winding: np.ndarray, runs: int
) -> dict[str, dict[str, Any]]:
    """Of each call seconds, wrong signs, and the largest error in the mesh's unit; or the sentence of its failure."""
    arrays = case.vertices.astype(np.float64), case.faces
    rows: dict[str, dict[str, Any]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for whose, call in calls.items():
            try:
                rows[whose] = judged(np.asarray(call(*arrays, points), dtype=np.float64), truth, winding)
            # A library may fail in any way on a nasty mesh, which is an answer too.
            except (ArithmeticError, LookupError, MemoryError, RuntimeError, ValueError) as error:
                rows[whose] = {"failed": f"{type(error).__name__}: {error}"[:200]}
        able = {whose: call for whose, call in calls.items() if "failed" not in rows[whose]}
        times: dict[str, list[tuple[float, float]]] = {whose: [] for whose in able}
        until = time.perf_counter() + MOST_SECONDS
        for turn in range(runs):
            if turn and time.perf_counter() > until:
                break
            for whose, call in able.items():
                wall, cpu = time.perf_counter(), time.process_time()
                call(*arrays, points)
                times[whose].append((time.perf_counter() - wall, time.process_time() - cpu))
    for whose, found in times.items():
        wall_s, cpu_s = (min(values) for values in zip(*found, strict=True))
        spread = 100 * (max(cpu for _, cpu in found) / cpu_s - 1.0)
        rows[whose] = {"wall_s": wall_s, "cpu_s": cpu_s, "cpu_spread": spread, "runs": len(found)} | rows[whose]
    return rows


def judged(found: np.ndarray, truth: np.ndarray, winding: np.ndarray) -> dict[str, Any]:
    """Wrong signs, how many could be wrong, values that are none, and the largest error."""
    sure = np.abs(winding - 0.5) > UNSURE
    # Of points on the surface either sign is right.
    off = truth > 1e-6 * truth.max()
    wrong = sure & off & ((found < 0) != (winding > 0.5))
    error = np.abs(np.abs(found) - truth)
    return {
        "wrong_signs": int(wrong.sum()),
        "sure": int((sure & off).sum()),
        "not_finite": int((~np.isfinite(found)).sum()),
        "largest_error": float(np.nanmax(error)),
    }


def text(whose: str, row: dict[str, Any]) -> str:
    if "failed" in row:
        return f"{whose}: failed ({row['failed'][:40]})"
    return f"{whose}: {row['cpu_s']:7.3f} s CPU, {row['wrong_signs']:4} wrong, error {row['largest_error']:.1e};"


if __name__ == "__main__":
    main()
