"""Are the kernels clean under compute-sanitizer? `python -m sdm.bench.gpu.sanitize --out bench/results/sanitizer.json`.

Runs bench/gpu/gpu_work.py: once alone, which compiles the kernels, then under memcheck (reads and writes out of bounds)
and racecheck (shared memory of a block read and written without an order). torch's own allocator is switched off, so
that every tensor is an allocation of its own, and one step past its end is seen.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdm.bench.common.checkout import checkout
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.errors import DeviceError, SDMError

TOOLS = ("memcheck", "racecheck")
WORK = ("-m", "sdm.bench.gpu.gpu_work", "cuda")
SUMMARY = re.compile(r"(?:ERROR|RACECHECK) SUMMARY: (.*)")
ERRORS = re.compile(r"(?:SUMMARY: |\()(\d+) (?:error|hazard)")
# The exit code that compute-sanitizer gives for what it found, told apart from the work's own.
FOUND = 86


def find_tool(name: str) -> str:
    """The path of a tool of the CUDA toolkit: on the PATH, or where the toolkit is usually put.

    Raises:
        SDMError: It is not there.
    """
    usual = [f"{os.environ.get('CUDA_HOME', '/usr/local/cuda')}/bin", "/opt/nvidia/bin"]
    usual += sorted((str(p) for p in Path("/usr/local").glob("cuda-*/bin")), reverse=True)
    usual += sorted((str(p) for p in Path("/opt/nvidia").glob("nsight-compute/*")), reverse=True)
    path = shutil.which(name) or shutil.which(name, path=os.pathsep.join(usual))
    if path is None:
        raise SDMError(f"{name} is not installed: it comes with the CUDA toolkit; put its folder on the PATH")
    return path


def check(tool: str, program: str, resolution: int, timeout_s: float) -> dict[str, Any]:
    """One tool's run over the work."""
    command = [program, "--tool", tool, "--error-exitcode", str(FOUND), "--print-limit", "20"]
    begin = time.monotonic()
    environment = {**os.environ, "PYTORCH_NO_CUDA_MEMORY_CACHING": "1"}
    try:
        done = subprocess.run(
            [*command, sys.executable, *WORK, str(resolution)],
            cwd=checkout(),
            check=False,
            env=environment,
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
    except subprocess.TimeoutExpired:
        return {"clean": None, "summary": f"stopped after {timeout_s:.0f} s", "seconds": time.monotonic() - begin}
    return judge(done.returncode, done.stdout + done.stderr) | {"seconds": time.monotonic() - begin}


def judge(code: int, said: str) -> dict[str, Any]:
    """Verdict on a run by its exit code and output: `clean` is None where the tool or the work itself failed."""
    found = SUMMARY.findall(said)
    summary = found[-1].strip() if found else None
    clean = code == 0 and summary is not None and all(int(n) == 0 for n in ERRORS.findall(f"SUMMARY: {summary}"))
    failed = summary is None or code not in (0, FOUND)
    result: dict[str, Any] = {"clean": None if failed else clean, "summary": summary, "exit_code": code}
    if not clean:
        result["output"] = said.splitlines()[-60:]
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 0 if all is clean, 1 if not, 2 if it cannot be told."""
    parser = argparse.ArgumentParser(
        "python -m sdm.bench.gpu.sanitize", description=(__doc__ or "").split("\n", maxsplit=1)[0]
    )
    parser.add_argument("--resolution", type=int, default=16, help="voxels along each axis of the small grids")
    parser.add_argument("--timeout-s", type=float, default=45.0, help="longest time of each tool")
    parser.add_argument("--tools", nargs="+", default=list(TOOLS), choices=[*TOOLS, "initcheck", "synccheck"])
    parser.add_argument("--out", type=Path, help="JSON file to write")
    options = parser.parse_args(argv)
    try:
        results = _run(options)
    except SDMError as error:
        print(error, file=sys.stderr)
        return 2
    verdicts = [result["clean"] for result in results.values()]
    return 0 if all(verdicts) else 2 if None in verdicts else 1


def _run(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    import torch

    if not torch.cuda.is_available():
        raise DeviceError("compute-sanitizer watches a GPU, and no CUDA device is there")
    program = find_tool("compute-sanitizer")
    plain = subprocess.run([sys.executable, *WORK, str(options.resolution)], cwd=checkout(), check=False)
    if plain.returncode:
        raise SDMError(f"the work fails without the tools already (exit code {plain.returncode}): mend that first")
    results: dict[str, dict[str, Any]] = {}
    for tool in options.tools:
        results[tool] = check(tool, program, options.resolution, options.timeout_s)
        print(f"{tool}: {results[tool]['summary']} ({results[tool]['seconds']:.0f} s)", flush=True)
        if options.out is not None:
            write(options.out, {**describe("cuda"), "resolution": options.resolution, "tools": results})
    return results


if __name__ == "__main__":
    sys.exit(main())
