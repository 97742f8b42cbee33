"""Time of a map on a GPU, kernel by kernel: `python -m sdm.bench.gpu.profile_kernels --out bench/results/profile.json`.

For each mesh and grid: the time of every kernel of one warm map by CUPTI, through torch's profiler, whose sum beside
the call's own time shows the gaps; and where ncu is installed and may read the counters, what limits each of the
longest kernels: the bytes that it moves and the instructions that it issues, how near both are to their peaks, how full
its warps and the GPU are, what they wait for. From these two floors, `bytes_floor_ms` and `issue_floor_ms`: the time
that as many bytes take at the memory's full rate, and as many instructions if each scheduler issued one each cycle.
"""

from __future__ import annotations

import argparse
import csv
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.markdown import markdown_table
from sdm.bench.gpu import ncu as _ncu
from sdm.bench.gpu.sanitize import find_tool
from sdm.errors import DeviceError, SDMError

MESHES = ("rocker-arm", "stanford-bunny", "nefertiti", "torus-1000000")
CASES = tuple(f"{mesh}:{resolution}" for resolution in (512, 256) for mesh in MESHES)
LONGEST = 10
# Of the kernels of a map those that take a while: of all of them ncu would take minutes.
WATCHED = "scan|sum_columns|witnesses|list_regions|list_cells|schedule|select|measure|search|open|merge|split"
_PER_ISSUE = "smsp__average_warps_issue_stalled_{}_per_issue_active.ratio"
# Warps that wait, and for what, by our names and ncu's.
STALLS = {
    "memory": "long_scoreboard",
    "shared": "short_scoreboard",
    "arithmetic": "wait",
    "instructions": "no_instruction",
    "branches": "branch_resolving",
    "memory_queue": "mio_throttle",
    "busy_units": "math_pipe_throttle",
    "another_warp": "not_selected",
}
METRICS = {
    "ms": "gpu__time_duration.sum",
    "instructions": "smsp__inst_executed.sum",
    "dram_bytes": "dram__bytes.sum",
    "l2_bytes": "lts__t_bytes.sum",
    "issued_of_time_percent": "smsp__issue_active.avg.pct_of_peak_sustained_elapsed",
    "bytes_of_time_percent": "dram__bytes.sum.pct_of_peak_sustained_elapsed",
    "arithmetic_percent": "sm__throughput.avg.pct_of_peak_sustained_elapsed",
    "dram_percent": "dram__throughput.avg.pct_of_peak_sustained_elapsed",
    "l1_percent": "l1tex__throughput.avg.pct_of_peak_sustained_active",
    "l2_percent": "lts__throughput.avg.pct_of_peak_sustained_elapsed",
    "issue_percent": "smsp__issue_active.avg.pct_of_peak_sustained_active",
    "occupancy_percent": "sm__warps_active.avg.pct_of_peak_sustained_active",
    "busy_percent": "sm__cycles_active.avg.pct_of_peak_sustained_elapsed",
    "threads_per_instruction": "smsp__thread_inst_executed_per_inst_executed.ratio",
    "l1_hit_percent": "l1tex__t_sector_hit_rate.pct",
    "l2_hit_percent": "lts__t_sector_hit_rate.pct",
    "registers": "launch__registers_per_thread",
    "fma_percent": "smsp__inst_executed_pipe_fma.sum.pct_of_peak_sustained_active",
    "alu_percent": "smsp__inst_executed_pipe_alu.sum.pct_of_peak_sustained_active",
    "lsu_percent": "smsp__inst_executed_pipe_lsu.sum.pct_of_peak_sustained_active",
    **{f"stalled_on_{ours}": _PER_ISSUE.format(theirs) for ours, theirs in STALLS.items()},
}
# Of these the sum over launches counts, of the others the mean.
COUNTS = ("instructions", "dram_bytes", "l2_bytes")
# ncu's units of time, in milliseconds.
UNITS = {"nsecond": 1e-6, "ns": 1e-6, "usecond": 1e-3, "us": 1e-3, "msecond": 1.0, "ms": 1.0, "second": 1e3, "s": 1e3}


def kernel_times(name: str, resolution: int) -> dict[str, Any]:
    """Milliseconds of each kernel of one warm map of a new mesh, longest first, and of the call."""
    import torch
    from torch.profiler import ProfilerActivity, profile

    from sdm.bench.common.grids import cube_around
    from sdm.bench.common.meshes import load_case
    from sdm.bench.common.timing import median
    from sdm.bench.dense.job import Ours

    case = load_case(name)
    ours, grid = Ours(case, "cuda"), cube_around(case, resolution)
    for _ in range(3):
        ours.map_new(grid)
    call = median(lambda: ours.map_new(grid), "cuda", 7, 2000).ms
    with profile(activities=[ProfilerActivity.CUDA]) as watched:
        ours.map_new(grid)
        torch.cuda.synchronize()
    kernels = [
        {"kernel": event.key[:80], "ms": event.self_device_time_total / 1e3, "calls": event.count}
        for event in watched.key_averages()
        if event.self_device_time_total > 0
    ]
    kernels.sort(key=lambda kernel: -kernel["ms"])
    return {
        "mesh": name,
        "triangles": len(case),
        "resolution": resolution,
        "call_ms": call,
        "kernels_ms": sum(kernel["ms"] for kernel in kernels),
        "kernels": kernels[: 2 * LONGEST],
    }


def counters(name: str, resolution: int, timeout_s: float) -> dict[str, Any]:
    """Counters by ncu of the kernels of one warm map, longest first; `why_not` if it says nothing."""
    try:
        command = [find_tool("ncu"), "--csv", "--page", "raw", "--profile-from-start", "off", "--print-units", "base"]
        # At the clocks at which maps are timed.
        command += ["--clock-control", "none", "--kernel-name", f"regex:{WATCHED}"]
        command += ["--metrics", ",".join(METRICS.values())]
        done = _ncu.run(command, name, resolution, timeout_s)
    except SDMError as error:
        return {"why_not": str(error)}
    found = read_ncu(done.stdout)
    if not found:
        return {"why_not": _ncu.complaint(done, "figures")}
    return {"kernels": found}


def read_ncu(text: str) -> list[dict[str, Any]]:
    """ncu's raw page as CSV, launches of the same kernel together (weighted by their time), longest first."""
    lines = text.splitlines()
    start = next((i for i, line in enumerate(lines) if line.startswith('"ID"')), None)
    if start is None:
        return []
    rows = list(csv.DictReader(io.StringIO("\n".join(lines[start:]))))
    units, launches = rows[0], rows[1:]
    scale = UNITS.get(units.get(METRICS["ms"], ""), 1e-6)
    together: dict[str, list[dict[str, float]]] = {}
    for launch in launches:
        values = {key: _number(launch.get(metric)) for key, metric in METRICS.items()}
        values["ms"] *= scale
        together.setdefault(launch["Kernel Name"][:80], []).append(values)
    found = []
    for kernel, several in together.items():
        total = sum(one["ms"] for one in several)
        mean = {
            key: sum(one[key] * one["ms"] for one in several) / total if total else several[0][key]
            for key in METRICS
            if key != "ms"
        }
        floors = {
            "issue_floor_ms": total * mean["issued_of_time_percent"] / 100,
            "bytes_floor_ms": total * mean["bytes_of_time_percent"] / 100,
        }
        for key in COUNTS:
            mean[key] = sum(one[key] for one in several)
        found.append({"kernel": kernel, "calls": len(several), "ms": total, **floors, **mean})
    return sorted(found, key=lambda kernel: -kernel["ms"])[:LONGEST]


def _number(text: str | None) -> float:
    try:
        return float((text or "").replace(",", ""))
    except ValueError:
        return 0.0


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 2 without a GPU."""
    parser = argparse.ArgumentParser(
        "python -m sdm.bench.gpu.profile_kernels", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument(
        "--cases", nargs="+", default=list(CASES), metavar="MESH:N", help="a mesh and a resolution each"
    )
    parser.add_argument("--no-ncu", action="store_true", help="times of kernels alone")
    parser.add_argument("--timeout-s", type=float, default=120.0, help="longest time of ncu for each case")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    options = parser.parse_args(argv)
    try:
        _run(options)
    except SDMError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _run(options: argparse.Namespace) -> None:
    import torch

    from sdm.bench.common.meshes import missing_note

    if not torch.cuda.is_available():
        raise DeviceError("there is no CUDA device to profile")
    results = []
    for case in options.cases:
        name, resolution = _ncu.case_of(case)
        if (note := missing_note(name)) is not None:
            print(note)
            continue
        result = kernel_times(name, resolution)
        if not options.no_ncu:
            result["ncu"] = counters(name, resolution, options.timeout_s)
        results.append(result)
        _print(result)
        if options.out is not None:
            write(options.out, {**describe("cuda"), "cases": results})


def _print(result: dict[str, Any]) -> None:
    title = f"{result['mesh']} at {result['resolution']}^3"
    print(f"\n{title}: {result['call_ms']:.3f} ms, of which kernels {result['kernels_ms']:.3f} ms\n")
    rows = [[k["kernel"][:60], str(k["calls"]), f"{k['ms']:.4f}"] for k in result["kernels"][:LONGEST]]
    print(markdown_table(["kernel", "calls", "ms"], rows))
    ncu = result.get("ncu", {})
    if "kernels" in ncu:
        names = ["ms", "issue_floor_ms", "bytes_floor_ms", *(name for name in METRICS if name != "ms")]
        rows = [[k["kernel"][:40], *(f"{k[name]:.3g}" for name in names)] for k in ncu["kernels"]]
        print(markdown_table(["kernel", *names], rows))
    elif ncu:
        print(ncu["why_not"])


if __name__ == "__main__":
    sys.exit(main())
