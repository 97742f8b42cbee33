"""The region that a ball reaches from beyond the mesh's box, moving from voxel to voxel: connected components.

Voxels are merged wherever the ball passes between two (`sdm.kernels.primitives.union_find`).
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.flood.flood_grid import FloodGrid, is_beyond, is_in_grid, is_open, length_of, number_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.union_find import merge, root_of

wp.set_module_options({"enable_backward": False})

# Beyond the mesh's box all is one region, whose root is voxel 0.
REACHED = 0


@wp.kernel
def _label_rows(begin: int, grid: FloodGrid, distances: wp.array(dtype=wp.float32), labels: wp.array(dtype=wp.int32)):
    """In each row along k, label the runs that the ball passes along: by their first voxel, or as reached."""
    row = begin + wp.tid()
    i = row / grid.shape[1]
    j = row % grid.shape[1]
    first = row * grid.shape[2]
    length = grid.spacing[2]
    run = int(first)
    before = wp.float64(0.0)
    # The bound is a variable so that Warp does not write the loop out.
    count = int(grid.shape[2])
    for k in range(count):
        at = first + k
        here = wp.float64(distances[at])
        passes = k > 0 and is_open(grid, before, here, length)
        if is_beyond(grid, i, j, k):
            if passes and run != REACHED:
                labels[run] = REACHED
            run = REACHED
        elif not passes:
            run = at
        labels[at] = run
        before = here


@wp.kernel
def _merge_rows(begin: int, grid: FloodGrid, distances: wp.array(dtype=wp.float32), labels: wp.array(dtype=wp.int32)):
    """Merge the runs of neighbouring rows, at each voxel with those of its neighbours that come before it."""
    at = begin + wp.tid()
    here = wp.float64(distances[at])
    if here < grid.radius:
        return
    k = at % grid.shape[2]
    row = at / grid.shape[2]
    j = row % grid.shape[1]
    i = row / grid.shape[1]
    # Its run goes through the voxel before, which moves to the same neighbours.
    if here >= grid.deep and k > 0:
        return
    beyond = is_beyond(grid, i, j, k)
    for place in range(12):
        # The neighbours of the layer before, and the three of the row before.
        number = int(place)
        di = int(-1)
        if number >= 9:
            di = int(0)
            number = number - 9
        dj = number / 3 - 1
        dk = number % 3 - 1
        # Far from the surface the ball comes to a diagonal neighbour by the others.
        if here < grid.deep or (dk == 0 and di * dj == 0):
            if is_in_grid(grid, i + di, j + dj, k + dk):
                if not (beyond and is_beyond(grid, i + di, j + dj, k + dk)):
                    other = number_of(grid, i + di, j + dj, k + dk)
                    if is_open(grid, wp.float64(distances[other]), here, length_of(grid, di, dj, dk)):
                        merge(labels, at, other)


@wp.kernel
def _find_roots(begin: int, labels: wp.array(dtype=wp.int32)):
    at = begin + wp.tid()
    labels[at] = root_of(labels, at)


def find_reached(grid: FloodGrid, distances: wp.array, labels: wp.array) -> None:
    """Label every voxel by its region: `REACHED`, or the number of another voxel.

    Args:
        grid: The voxels; voxel 0 is beyond the mesh's box.
        distances: (N,) float32, unsigned.
        labels: (N,) int32, filled.
    """
    nx, ny, nz = grid.shape
    launch(_label_rows, nx * ny, [grid, distances, labels], labels.device, smallest=16)
    launch(_merge_rows, nx * ny * nz, [grid, distances, labels], labels.device)
    launch(_find_roots, nx * ny * nz, [labels], labels.device)
