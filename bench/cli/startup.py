"""Start-up: seconds that `sdm inspect`, `sdm compute` and a map in Python, of a small mesh, take beyond `import torch`.

`python -m sdm.bench.cli.startup` prints a table, with the dearest imports; `--out FILE.json` keeps the figures.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.core.mesh import TriangleMesh
from sdm.io.meshes.write import write_ply

RESOLUTION = 32
IMPORTS = 15


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the start-up of the commands.")
    parser.add_argument("--runs", type=int, default=9, help="of each command, in turns; the median counts")
    parser.add_argument("--out", type=Path, help="also write the figures to this JSON file")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        record = measure(Path(name), options.runs)
    for command, seconds in record["seconds"].items():
        print(f"{command:<16}{seconds['wall']:7.2f} s, {seconds['cpu']:.2f} s of CPU", end="")
        print(f"; {record['beyond_torch'][command]:.2f} s beyond torch" if command in record["beyond_torch"] else "")
    for command, imports in record["imports_ms"].items():
        print(f"{command}: " + ", ".join(f"{module} {ms:.0f}" for module, ms in imports.items()) + " ms")
    if options.out is not None:
        write(options.out, record)


def measure(folder: Path, runs: int) -> dict[str, Any]:
    """Median wall and CPU seconds of each command, each called once before any is timed."""
    vertices, faces = _sphere()
    write_ply(TriangleMesh(vertices, faces), folder / "sphere.ply")
    program = [sys.executable, "-m", "sdm"]
    commands = {
        "import torch": [sys.executable, "-c", "import torch"],
        "sdm inspect": [*program, "inspect", "sphere.ply"],
        "sdm compute": [*program, "compute", "sphere.ply", "-o", "sphere.npz", "--resolution", str(RESOLUTION)],
        "a map in Python": [
            sys.executable,
            "-c",
            f"import sdm; sdm.signed_distance_map(sdm.load_mesh('sphere.ply'), resolution={RESOLUTION})",
        ],
    }
    for command in commands.values():
        _run(command, folder)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    for _ in range(runs):
        for name, command in commands.items():
            times[name].append(_run(command, folder))
    seconds = {
        name: {"wall": statistics.median(wall for wall, _ in pairs), "cpu": statistics.median(cpu for _, cpu in pairs)}
        for name, pairs in times.items()
    }
    torch_alone = seconds["import torch"]["wall"]
    return {
        "machine": describe("cpu"),
        "triangles": len(faces),
        "resolution": RESOLUTION,
        "runs": runs,
        "seconds": seconds,
        "beyond_torch": {name: seconds[name]["wall"] - torch_alone for name in commands if name != "import torch"},
        "imports_ms": {name: _imports(commands[name][1:], folder) for name in commands if name != "import torch"},
    }


def _sphere() -> tuple[Any, Any]:
    from sdm.bench.common.mesh_formulas import sphere

    return sphere(18)


def _run(command: list[str], folder: Path) -> tuple[float, float]:
    before, start = os.times(), time.perf_counter()
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - start, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, cpu


def _imports(words: list[str], folder: Path) -> dict[str, float]:
    """The modules outside of torch whose own code takes longest to import, in milliseconds."""
    command = [sys.executable, "-X", "importtime", *words]
    lines = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stderr.splitlines()
    found: dict[str, float] = {}
    for line in lines:
        parts = line.removeprefix("import time:").split("|")
        if len(parts) == 3 and parts[0].strip().isdigit() and not parts[2].strip().startswith("torch"):
            found[parts[2].strip()] = int(parts[0]) / 1000
    return dict(sorted(found.items(), key=lambda item: -item[1])[:IMPORTS])


if __name__ == "__main__":
    main()
