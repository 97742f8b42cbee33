"""Memory that one narrow band takes on a CPU: `python -m sdm.bench.band.peak_memory MESH RESOLUTION HALF_WIDTH`.

Prints the bytes that the process had more at its highest than before. A band of few voxels is made first, so that
kernels are loaded.
"""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from pathlib import Path

import sdm
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import load_case


def status(name: str) -> int:
    """A line of the process's status, in bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


def main() -> None:
    """The command."""
    case = load_case(sys.argv[1])
    resolution, half_width = int(sys.argv[2]), float(sys.argv[3])
    mesh = sdm.TriangleMesh(case.vertices, case.faces, case.name, check=False)
    sdm.narrow_band(mesh, cube_around(case, 32), half_width=half_width, device="cpu")
    # Memory that was given back but is kept for reuse would not count.
    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    # From here on the highest is counted anew.
    Path("/proc/self/clear_refs").write_text("5")
    before = status("VmRSS")
    sdm.narrow_band(mesh, cube_around(case, resolution), half_width=half_width, device="cpu")
    print(status("VmHWM") - before)


if __name__ == "__main__":
    main()
