"""One warm map, again and again, for a profiler: `python -m sdm.bench.gpu.map_work MESH RESOLUTION [TIMES]`.

The profiler's range (cudaProfilerStart to Stop) holds the last call alone: topology, structure and map.
"""

from __future__ import annotations

import sys

import torch

from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import load_case
from sdm.bench.dense.job import Ours


def main() -> int:
    """Arguments: mesh, resolution, warm calls before."""
    name, resolution, times = sys.argv[1], int(sys.argv[2]), int((*sys.argv[3:], "3")[0])
    case = load_case(name)
    ours, grid = Ours(case, "cuda"), cube_around(case, resolution)
    for _ in range(times):
        ours.map_new(grid)
    torch.cuda.synchronize()
    torch.cuda.profiler.start()
    ours.map_new(grid)
    torch.cuda.synchronize()
    torch.cuda.profiler.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
