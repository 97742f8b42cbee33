"""Stage 7 of the dense query: the merge of splits, in the voxels of cells whose list is cut into several.

Several blocks measure such a voxel, and each lessens its distance, which is infinite before the first and known only
after the last. If one of the splits found no room it is not known: the least of the others may not be the least.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.block_schedule import BlockSchedule
from sdm.kernels.dense.cell_cache import CellCache, cached_start
from sdm.kernels.dense.counters import SPLIT_CELLS
from sdm.kernels.dense.region_grid import BLOCK, RegionGrid
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import (
    Output,
    Slab,
    distances_at,
    index_of,
    is_unclear,
    put_distance,
    slab_of,
    with_sign,
)
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import GPU_LANES, ballot, members, on_cpu

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor of a GPU holds: a voxel is little work, and four reads that wait for each other.
SPLIT_BLOCKS_PER_SM = 16


@wp.func
def split_voxels(grid: RegionGrid, schedule: BlockSchedule):
    """Number of voxels in cells whose lists are cut into splits."""
    return grid.cell * grid.cell * grid.cell * schedule.counters[SPLIT_CELLS]


@wp.func
def split_voxel(slab: Slab, grid: RegionGrid, cache: CellCache, schedule: BlockSchedule, number: int):
    """The mesh, the cell and the index of one of them; -1 if it is beyond the slab."""
    # Cells have 4, 8 or 16 voxels along an edge, so that nothing has to be divided.
    bits = wp.where(grid.cell < BLOCK, 2, wp.where(grid.cell == BLOCK, 3, 4))
    last = grid.cell - 1
    cell = schedule.split_cells[number >> (3 * bits)]
    mesh, start = cached_start(cache, cell)
    here = slab_of(slab, mesh)
    at = start + wp.vec3i((number >> (2 * bits)) & last, (number >> bits) & last, number & last)
    return mesh, cell, wp.where(is_within(here, at), index_of(here, mesh, at), -1)


@wp.func
def add_unclear(out: Output, mesh: int, unclear: int, number: int):
    """Add what a group of lanes has counted to a mesh's ambiguous voxels, once for all lanes; nothing is left."""
    if unclear > 0 and (on_cpu() or number % GPU_LANES == 0):
        fetch_add(out.ambiguous, mesh, unclear)
    return int(0)


@wp.kernel
def _begin_split(
    begin: int, threads: int, slab: Slab, grid: RegionGrid, cache: CellCache, schedule: BlockSchedule, out: Output
):
    """Begin with a distance for the splits to lessen: an infinite one, with its sign.

    The lanes of a group are in one cell: they count its ambiguous voxels together, as a million additions to one count
    took longer than all distances.
    """
    number = begin + wp.tid()
    unclear = int(0)
    counted = int(0)
    while number < split_voxels(grid, schedule):
        mesh, _cell, index = split_voxel(slab, grid, cache, schedule, number)
        if mesh != counted:
            unclear = add_unclear(out, counted, unclear, number)
            counted = mesh
        found = int(0)
        if index >= 0:
            winding = out.values[index]
            out.values[index] = with_sign(float(wp.inf), winding)
            found = is_unclear(winding)
        unclear = unclear + members(ballot(found != 0))
        number = number + threads
    add_unclear(out, counted, unclear, number)


@wp.kernel
def _end_split(
    begin: int, threads: int, slab: Slab, grid: RegionGrid, cache: CellCache, schedule: BlockSchedule, out: Output
):
    """End with the distances that the splits came to, which are known after the last of them."""
    number = begin + wp.tid()
    while number < split_voxels(grid, schedule):
        _mesh, cell, index = split_voxel(slab, grid, cache, schedule, number)
        if index >= 0:
            distance = out.values[index]
            if schedule.lacking[cell] != 0:
                distance = wp.where(distance < 0.0, -float(wp.inf), float(wp.inf))
            put_distance(distances_at(out), index, distance)
            if not wp.abs(distance) < float(wp.inf):
                fetch_add(out.missed, 0, 1)
        number = number + threads


def begin_split(
    slab: Slab, grid: RegionGrid, cache: CellCache, schedule: BlockSchedule, out: Output, threads: int
) -> None:
    """Before `measure_blocks`: infinite distances with their signs in cells whose lists are cut into splits."""
    launch(_begin_split, threads, [threads, slab, grid, cache, schedule, out], out.values.device, smallest=1)


def end_split(
    slab: Slab, grid: RegionGrid, cache: CellCache, schedule: BlockSchedule, out: Output, threads: int
) -> None:
    """After `measure_blocks`: write what the splits came to where distances go, and count what was missed there."""
    launch(_end_split, threads, [threads, slab, grid, cache, schedule, out], out.values.device, smallest=1)
