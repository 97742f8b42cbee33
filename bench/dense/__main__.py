"""Speed of dense maps, and its growth with triangles and voxels.

    python -m sdm.bench.dense --device cuda --out bench/results/dense-cuda.json

Parts: `table` (four meshes against the faster of the peers, geometric means), `batch` (maps a second), `points`,
`triangles` and `resolution` (how the time grows), `worst` (meshes made to be hard), `graph` (in a CUDA graph), `signs`
(what the sign costs), `slices` (thick ones), `closest` (what closest points cost).

sdm's time goes from vertices and faces on the device to the map: topology, structure and query. It is that of repeated
calls: on a GPU meshes with as many vertices, faces and boundary edges were mapped before, so the call is a CUDA graph;
`first_ms` is the first call of a mesh of its counts, after one of a mesh of others (`cold_ms`). A peer's time is its
query alone. Medians; spread is slowest less fastest, of the median. A peer that would take longer than its share of the
budget is timed on random slabs, one in each eighth of the grid, and scaled; `share` says how much that was. Voxels are
checked against a float64 brute force, half of them near the surface.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import sdm
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.markdown import machine_line, markdown_table
from sdm.bench.dense.job import Job
from sdm.core.device import choose_device

# Seconds for each part on a GPU; compiling is in them.
BUDGETS_S = {
    "table": 120.0,
    "batch": 20.0,
    "points": 45.0,
    "triangles": 45.0,
    "resolution": 30.0,
    "worst": 30.0,
    "graph": 15.0,
    "signs": 20.0,
    "slices": 30.0,
    "closest": 60.0,
}
QUICK_S = 6.0
PACKAGES = ("warp-lang", "torch", "numpy", "libigl", "open3d")


def run_part(part: str, job: Job, out: Path | None, report: dict[str, Any], **choices: Any) -> dict[str, Any]:
    """Run one part, print its table, and put it into `report` and the file, after every row."""
    module = importlib.import_module(f"sdm.bench.dense.parts.{part}")
    found: list[dict[str, Any]] = []
    result: dict[str, Any] = {"complete": False, "quick": job.quick, "rows": found}
    for row in module.rows(job, **choices):
        found.append(row)
        _save(out, report, part, result)
        print(f"  {part}: {row.get('mesh')} {row.get('resolution', row.get('kind', ''))}", file=sys.stderr, flush=True)
    result["summary"] = module.summary(found)
    result |= {"complete": not job.notes, "notes": job.notes, "seconds": time.monotonic() - job.started}
    # Clocks as they are right after the work.
    result["machine"] = describe(job.device, PACKAGES)
    _save(out, report, part, result)
    _print(part, result, module.lines(found, result["summary"]))
    return result


def _save(out: Path | None, report: dict[str, Any], part: str, result: dict[str, Any]) -> None:
    report["parts"][part] = result
    if out is not None:
        write(out, report)


def _print(part: str, result: dict[str, Any], lines: list[list[str]]) -> None:
    width = len(lines[0])
    rows = [line + [""] * (width - len(line)) for line in lines[1:] if len(line) > 1]
    print(f"\n{part} ({result['seconds']:.0f} s)\n\n{markdown_table(lines[0], rows)}")
    for note in (*(line[0] for line in lines[1:] if len(line) == 1), *result["notes"]):
        print(note)
    print(machine_line(result["machine"]), flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 1 if a value of sdm's was wrong, 2 for a bad request."""
    parser = argparse.ArgumentParser(
        "python -m sdm.bench.dense", description=(__doc__ or "").split("\n", maxsplit=1)[0]
    )
    parser.add_argument("--device", help="cpu or cuda (default: cuda if there)")
    parser.add_argument("--parts", nargs="+", choices=list(BUDGETS_S), default=None, help="default: all")
    parser.add_argument("--budget-s", type=float, help="seconds for each part (default: by part)")
    parser.add_argument("--runs", type=int, default=7, help="timed calls for each of sdm's figures")
    parser.add_argument("--quick", action="store_true", help="in miniature: under a minute on two cores")
    parser.add_argument("--meshes", nargs="+", metavar="MESH", help="of the table: names, torus-N, or files")
    parser.add_argument("--resolutions", nargs="+", type=int, metavar="N", help="of the table: voxels along each axis")
    parser.add_argument("--out", type=Path, help="JSON file; other parts that it holds already stay")
    options = parser.parse_args(argv)
    try:
        return _run(options)
    except (sdm.SDMError, KeyError, FileNotFoundError) as error:
        print(error.args[0], file=sys.stderr)
        return 2


def _run(options: argparse.Namespace) -> int:
    if options.runs < 1 or (options.budget_s is not None and not options.budget_s > 0):
        raise sdm.SDMError("runs must be at least 1 and the budget a positive time in seconds")
    device = str(choose_device(options.device))
    report: dict[str, Any] = {"parts": {}}
    if options.out is not None and options.out.is_file():
        report = _earlier(options.out)
    wrong = 0
    for part in options.parts or BUDGETS_S:
        budget = options.budget_s or (QUICK_S if options.quick else BUDGETS_S[part])
        job = Job(device, options.quick, budget, min(options.runs, 3) if options.quick else options.runs)
        choices: dict[str, Any] = {}
        if part == "table":
            choices = {"meshes": tuple(options.meshes or ()), "resolutions": tuple(options.resolutions or ())}
        wrong += run_part(part, job, options.out, report, **choices)["summary"].get("wrong", 0)
    return int(wrong > 0)


def _earlier(out: Path) -> dict[str, Any]:
    try:
        report = json.loads(out.read_text())
        if isinstance(report["parts"], dict):
            return report
    except (ValueError, KeyError, TypeError):
        pass
    raise sdm.FormatError(f"{out} is there and holds no results of this benchmark: give another file")


if __name__ == "__main__":
    sys.exit(main())
