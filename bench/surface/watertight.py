"""`sdm watertight` as a user meets it: seconds from file to file, of fresh processes, repeated calls and a folder.

    python -m sdm.bench.surface.watertight --device cuda --out watertight-cuda.json

Each mesh is written as a PLY file, closed at each resolution and written again, by the command:

- `process`: the whole command in a process of its own, Python and torch included; `torch` is what a process takes that
  imports torch alone. Kernels are in Warp's cache: the first such process, which may compile them, is not counted.
- `call`: the same from file to file in a process that runs on. `imports` is what comes before: the parser, torch, Warp
  and the command's modules, and beside them the GPU, made ready as the command does it. `first` is the first call and
  `warm` the median of those after it, with the report (exact distances both ways), and `without_report` what reading,
  closing and writing take without it.
- `folder`: seconds a file of a folder of `--copies` of the mesh, where reading and writing run beside the device.

`closed` says that each edge of what was written has two triangles, one each way.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import load_case, missing_note
from sdm.bench.surface.figures import draw_watertight
from sdm.io.meshes.write import save_mesh

MESHES = ("fandisk", "rocker-arm", "nefertiti")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--meshes", nargs="*", default=list(MESHES), help="names, torus-N, or files")
    parser.add_argument("--resolutions", type=int, nargs="*", default=[1024])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--processes", type=int, default=3, help="fresh processes of each that are counted; 0 for none")
    parser.add_argument("--copies", type=int, default=8, help="files of the folder")
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args()
    report: dict[str, Any] = {"machine": describe(given.device), "runs": given.runs, "copies": given.copies, "rows": []}
    if given.processes:
        report["torch"] = _processes([sys.executable, "-c", "import torch"], given.processes)
        print("a process that imports torch", *(f"{seconds:.2f}" for seconds in report["torch"]), "s", flush=True)
    for name in given.meshes:
        if (why := missing_note(name)) is not None:
            print(why)
            continue
        case = load_case(name)
        mesh = sdm.TriangleMesh(case.vertices, case.faces, case.name, check=False)
        for resolution in given.resolutions:
            with tempfile.TemporaryDirectory() as folder:
                row = measure(mesh, Path(folder), resolution, given.device, given.runs, given.processes, given.copies)
            report["rows"].append(row)
            print(line(row), flush=True)
            if given.out:
                json_file.write(given.out, report)
    if given.out and report["rows"]:
        draw_watertight(report, given.out.with_suffix(".png"))


def line(row: dict[str, Any]) -> str:
    """One line of what is printed."""
    begin = f"{row['mesh']:16}{row['resolution']:>6}: imports {row['imports']:.2f} s, first call {row['first']:.3f}, "
    rest = f"warm {row['warm']:.3f}, without report {row['without_report']:.3f}, in a folder {row['folder']:.3f} a file"
    process = f", a process {statistics.median(row['process']):.2f}" if row["process"] else ""
    return begin + rest + process + ("" if row["closed"] else ", NOT CLOSED")


def measure(
    mesh: sdm.TriangleMesh, folder: Path, resolution: int, device: str, runs: int, processes: int, copies: int
) -> dict[str, Any]:
    """A row of the record."""
    source, target = folder / "in.ply", folder / "out.ply"
    save_mesh(mesh, source)
    how = ["--resolution", str(resolution), "--device", device]
    words = [str(source), "-o", str(target), *how]
    row: dict[str, Any] = {"mesh": mesh.name, "triangles": len(mesh), "resolution": resolution}
    row["process"] = _processes([sys.executable, "-m", "sdm.cli", "watertight", *words], processes)
    imports, *calls = _seconds(words, 1 + runs)
    row |= {"imports": imports, "first": calls[0], "warm": statistics.median(calls[1:]), "calls": calls}
    written = sdm.load_mesh(target)
    row |= {"output_triangles": len(written), "closed": _is_closed(written.faces.numpy())}
    alone = [_without_report(source, target, resolution, device) for _ in range(runs)]
    row |= {"without_report": statistics.median(alone), "alone": alone}
    many = folder / "many"
    many.mkdir()
    for number in range(copies):
        save_mesh(mesh, many / f"{number}.ply")
    # A call before it, so that nothing of the process itself is counted.
    row["folder"] = _seconds([str(many), "-o", str(folder / "closed"), *how], 2)[2] / copies
    return row


# Times calls of the command in one process: the number of calls, and its words. Benchmarks do not import commands.
# First what the command itself does before its work, in its order: words are parsed, modules imported.
_CALLS = """
import contextlib, io, json, sys, time
begin = time.perf_counter()
from sdm.cli.app import main
with contextlib.redirect_stdout(io.StringIO()):
    main([sys.argv[2], "--help"])
from sdm.runtime import early_device
early_device.begin(sys.argv[sys.argv.index("--device") + 1])
import sdm.kernels.flood.flood_signs
import sdm.cli.surfaces.closing
seconds = [time.perf_counter() - begin]
for _ in range(int(sys.argv[1])):
    begin = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        code = main(sys.argv[2:])
    seconds.append(time.perf_counter() - begin)
    if code:
        sys.exit(code)
print(json.dumps(seconds))
"""


def _seconds(words: list[str], calls: int) -> list[float]:
    """Seconds of imports, and of calls of the command, in a process of its own."""
    command = [sys.executable, "-c", _CALLS, str(calls), "watertight", *words]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def _without_report(source: Path, target: Path, resolution: int, device: str) -> float:
    """Seconds of the same by the library."""
    begin = time.perf_counter()
    save_mesh(sdm.watertight(sdm.load_mesh(source), resolution, device=device).to("cpu"), target)
    return time.perf_counter() - begin


def _processes(words: list[str], count: int) -> list[float]:
    """Seconds of a command in processes of their own, after one that is not counted."""
    found = []
    for _ in range(1 + count if count else 0):
        begin = time.perf_counter()
        subprocess.run(words, check=True, capture_output=True, env=os.environ)
        found.append(time.perf_counter() - begin)
    return found[1:]


def _is_closed(faces: np.ndarray) -> bool:
    """True if each edge is there once each way."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    keys, other = pairs[:, 0] << 32 | pairs[:, 1], pairs[:, 1] << 32 | pairs[:, 0]
    return len(np.unique(keys)) == len(keys) and bool(np.array_equal(np.sort(keys), np.sort(other)))


if __name__ == "__main__":
    main()
