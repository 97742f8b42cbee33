"""Error of the family's maps by their first modes, on shapes that the modes have not seen.

    python -m sdm.bench.surrogate.spectrum [--maps 300] [--spacing 0.4] [--budget-s 50]

Half a minute on a CPU for a few hundred maps at 0.4 mm. Prints the mean absolute error of the projection, everywhere
and within 0.5 mm of the surface: no surrogate that is linear in its modes can do better.
"""

from __future__ import annotations

import argparse
import time

import torch

from sdm.bench.common.markdown import markdown_table
from sdm.core.device import choose_device
from sdm.core.grid import Grid
from sdm.shapes import Cochlea
from sdm.stream import SDMStream
from sdm.surrogate import GRID
from sdm.surrogate.networks.pod_chebyshev import decompose

MODES = (8, 16, 32, 64, 128, 208, 256, 512)
# Share of the maps that the modes do not see.
HELD_OUT = 0.15


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", type=int, default=300)
    parser.add_argument("--spacing", type=float, default=0.4, help="voxel size [mm]")
    parser.add_argument("--budget-s", type=float, default=50.0, help="make no more maps after this")
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    low = torch.tensor(GRID.origin) - GRID.spacing[0] / 2
    size = torch.tensor(GRID.shape) * GRID.spacing[0]
    shape = [round(float(x) / options.spacing) for x in size]
    grid = Grid((low + options.spacing / 2).tolist(), (options.spacing,) * 3, shape)
    device = choose_device(options.device)
    stream = SDMStream(Cochlea(), grid, 4, 0, 0, 1, sampler="sobol", device=device)
    made, start = [], time.perf_counter()
    for batch in stream:
        made.append(batch.sdm.flatten(1))
        if 4 * len(made) >= options.maps or time.perf_counter() - start > options.budget_s:
            break
    maps = torch.cat(made)
    count = round((1 - HELD_OUT) * len(maps))
    seen, other = maps[:count], maps[count:]
    mean, modes, _ = decompose(seen, min(max(MODES), count - 1))
    near = other.abs() < 0.5
    rows = []
    for number in [m for m in MODES if m <= len(modes)]:
        part = modes[:number]
        error = ((other - mean) - (other - mean) @ part.T @ part).abs()
        rows.append([str(number), f"{float(error.mean()):.4f}", f"{float(error[near].mean()):.4f}"])
    print(f"{count} maps of {shape} voxels give the modes, {len(other)} others are approximated; errors in mm")
    print(markdown_table(["modes", "everywhere", "near the surface"], rows))


if __name__ == "__main__":
    main()
