"""Time of one core to write a map in each format and to read it: `python -m sdm.bench.disk.map_formats`.

Beside it that of NumPy alone to put a volume's axes in reverse, which files of images need, and of
`sdm.core.axis_order`. The least processor time of some turns, of a torus in a cube, into a folder of temporary files.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.grids import cube_around
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import load_case
from sdm.core.axis_order import reversed_axes

FORMATS = ("nii", "nii.gz", "nrrd", "mha", "vti", "npz", "zarr")
MESH = "torus-20000"


def rows(resolution: int, turns: int) -> list[dict[str, Any]]:
    """Milliseconds of each format at so many voxels along an axis.

    Raises:
        RuntimeError: A map is not read as it was written.
    """
    case = load_case(MESH)
    field = sdm.signed_distance_map(sdm.TriangleMesh(case.vertices, case.faces), cube_around(case, resolution))
    values = field.values.numpy()
    found = [
        {
            "resolution": resolution,
            "format": "axes in reverse",
            "numpy_ms": _least(lambda: np.ascontiguousarray(values.T), turns),
            "ms": _least(lambda: reversed_axes(values), turns),
        }
    ]
    with tempfile.TemporaryDirectory() as folder:
        for ending in FORMATS:
            file = Path(folder, f"map.{ending}")
            save_ms = _least(lambda file=file: sdm.save(field, file), turns)
            load_ms = _least(lambda file=file: sdm.load(file), turns)
            if not torch.equal(sdm.load(file).values, field.values):
                raise RuntimeError(f"{ending} is not read as it was written")
            found.append({"resolution": resolution, "format": ending, "save_ms": save_ms, "load_ms": load_ms})
    return found


def _least(call: Callable[[], Any], turns: int) -> float:
    taken = []
    for _ in range(turns):
        begin = time.process_time()
        call()
        taken.append(time.process_time() - begin)
    return round(1e3 * min(taken), 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolutions", type=int, nargs="+", default=[128, 256], help="voxels along an axis")
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    torch.set_num_threads(1)
    found = []
    for resolution in options.resolutions:
        for row in rows(resolution, options.turns):
            found.append(row)
            print(" ".join(f"{key} {value}" for key, value in row.items()), flush=True)
    if options.out is not None:
        json_file.write(options.out, {"machine": describe("cpu"), "turns": options.turns, "rows": found})


if __name__ == "__main__":
    main()
