"""Running ncu on one warm map, and what it says where it fails."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

from sdm.bench.common.checkout import checkout
from sdm.errors import SDMError


def case_of(text: str) -> tuple[str, int]:
    """A mesh's name and a resolution from MESH:N."""
    name, _, resolution = text.rpartition(":")
    if not name or not resolution.isdigit():
        raise SDMError(f"{text!r} is no case: write a mesh and a resolution, as in rocker-arm:256")
    return name, int(resolution)


def run(command: Sequence[str], name: str, resolution: int, timeout_s: float) -> subprocess.CompletedProcess[str]:
    """ncu with these options, over the last of a few maps of a mesh."""
    try:
        return subprocess.run(
            [*command, sys.executable, "-m", "sdm.bench.gpu.map_work", name, str(resolution)],
            cwd=checkout(),
            check=False,
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
    except subprocess.TimeoutExpired:
        raise SDMError(f"ncu took longer than {timeout_s:.0f} s: give it more with --timeout-s") from None


def complaint(done: subprocess.CompletedProcess[str], wanted: str) -> str:
    """Why there is no `wanted`: ncu's own words, or how it ended."""
    said = [line for line in (done.stdout + done.stderr).splitlines() if "==ERROR==" in line or "Error" in line]
    return said[0] if said else f"ncu ended with {done.returncode} and no {wanted}"
