"""Work that the host queues for a narrow band: kernels, memsets, sorts, torch's operations, and reads of the device.

    python -m sdm.bench.band.launch_counts [--names]

A band of a closed mesh is made on a CPU by the steps of a GPU (see `sdm.bench.dense.launch_counts`): step by step from
a mesh never seen before, and as it is recorded, which is one launch and one read when it is replayed, and a copy.
"""

from __future__ import annotations

import argparse
from unittest import mock

import torch

import sdm
from sdm.bench.common.meshes import torus
from sdm.bench.dense.launch_counts import Counts, as_on_a_gpu, counting
from sdm.engine.band import near_blocks, repeated_bands
from sdm.engine.band.calls import band_width
from sdm.engine.band.listed_blocks import Room
from sdm.kernels.dense.cost_model import NO_SPLITS
from sdm.runtime.graphs import unverified


def counted(triangles: int, resolution: int, *, recorded: bool) -> Counts:
    """The counts of one band of a torus."""
    vertices, faces = torus(triangles)
    grid = sdm.Grid.around(sdm.TriangleMesh(vertices, faces), resolution)
    found = Counts()
    with as_on_a_gpu(NO_SPLITS), torch.no_grad(), mock.patch.object(near_blocks, "BY_TRIANGLES", ("cpu",)):
        for _ in range(2):
            # The first time kernels are compiled.
            mesh = sdm.TriangleMesh(vertices.copy(), faces.copy(), check=False)
            with counting() as found:
                if recorded:
                    room = Room((resolution // 8) ** 3, (resolution // 32) ** 3)
                    call = repeated_bands.band_call(mesh, grid, band_width(grid, 3.0), room)
                    call.work(unverified, *call.inputs)
                else:
                    sdm.MeshIndex(mesh, "cpu", warn=False).narrow_band(grid)
    return found


def main() -> None:
    """Print the table, and with `--names` what is in it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=20_000)
    parser.add_argument("--resolutions", type=int, nargs="*", default=[64, 256])
    parser.add_argument("--names", action="store_true", help="also print each kernel and operation")
    given = parser.parse_args()
    for resolution in given.resolutions:
        for recorded in (False, True):
            found = counted(given.triangles, resolution, recorded=recorded)
            name = f"{resolution}^3, {'as recorded' if recorded else 'step by step'}"
            print(f"{name:24}" + "  ".join(f"{kind} {number}" for kind, number in found.totals().items()))
            if given.names:
                for kind, names in found.found.items():
                    print(f"    {kind}: " + ", ".join(f"{key} {number}" for key, number in names.items()))


if __name__ == "__main__":
    main()
