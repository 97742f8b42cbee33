"""The plain dense query: one search of the tree for every voxel. The seven stages do the same faster."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_hit, nearest_slot
from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, UNSCALE, Tree, slots_of, tree_of
from sdm.kernels.geometry.voxel_grid import (
    SEARCHED,
    Output,
    Slab,
    distances_at,
    index_of,
    put_distance,
    read_distance,
    slab_of,
    voxel,
    voxel_at,
    write_distance,
)
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add

wp.set_module_options({"enable_backward": False})

# The tile of (x,y) that neighbouring threads share.
TILE = 4
# Voxels along z that one thread takes one after the other, each from the answer before it. A GPU would rather have
# more threads.
CPU_RUN = 8


@wp.func
def searched_distance(tree: Tree, mesh: int, point: wp.vec3, guess: int):
    """Distance of a point from a mesh, and the slot of the triangle nearest to it."""
    scale = tree.frame[mesh * FRAME_SIZE + SCALE]
    slot = nearest_slot(tree, mesh, float(scale) * point, guess)
    hit = exact_hit(tree, slot, scale * wp.vec3d(point))
    return float(wp.sqrt(hit.distance2) * tree.frame[mesh * FRAME_SIZE + UNSCALE]), slot


@wp.func
def note_searched(out: Output, index: int, slot: int):
    """Note that a voxel's distance is from the triangle in a slot, if that is wanted."""
    if out.winners.shape[0] > 0:
        out.winners[index] = 8 * slot + SEARCHED
        out.searched[0] = 1


@wp.kernel
def _measure(
    begin: int,
    tree: Tree,
    slab: Slab,
    length: int,
    out: Output,
):
    thread = begin + wp.tid()
    tiles_j = (slab.shape[1] + TILE - 1) / TILE
    tiles_i = (slab.shape[0] + TILE - 1) / TILE
    runs = (slab.shape[2] + length - 1) / length
    inner = thread % (TILE * TILE)
    rest = thread / (TILE * TILE)
    run = rest % runs
    rest = rest / runs
    j = (rest % tiles_j) * TILE + inner % TILE
    rest = rest / tiles_j
    i = (rest % tiles_i) * TILE + inner / TILE
    mesh = rest / tiles_i
    one = tree_of(tree, mesh)
    shape = slab_of(slab, mesh).shape
    if i >= shape[0] or j >= shape[1]:
        return
    guess = slots_of(one, mesh)
    unclear = int(0)
    for step in range(length):
        k = run * length + step
        if k < shape[2]:
            distance, guess = searched_distance(one, mesh, voxel(slab_of(slab, mesh), i, j, k), guess)
            index = index_of(slab_of(slab, mesh), mesh, wp.vec3i(i, j, k))
            unclear = unclear + write_distance(out, index, distance)
            note_searched(out, index, guess)
    if unclear > 0:
        fetch_add(out.ambiguous, mesh, unclear)


def search_slab(tree: Tree, slab: Slab, out: Output, meshes: int) -> None:
    """Replace winding numbers by signed distances, and count the unclear ones."""
    nx, ny, nz = slab.shape
    tile, run = int(TILE), 1 if out.values.device.is_cuda else CPU_RUN
    threads = meshes * -(-nx // tile) * -(-ny // tile) * -(-nz // run) * tile * tile
    launch(_measure, threads, [tree, slab, run, out], out.values.device)


@wp.kernel
def _mend(begin: int, tree: Tree, slab: Slab, step: int, out: Output):
    number = begin + wp.tid()
    if out.missed[0] == 0:
        return
    address = distances_at(out)
    while number < out.values.shape[0]:
        value = read_distance(address, number)
        if value == wp.inf or value == -wp.inf:
            mesh, at = voxel_at(slab, number)
            one = tree_of(tree, mesh)
            point = voxel(slab_of(slab, mesh), at[0], at[1], at[2])
            distance, slot = searched_distance(one, mesh, point, slots_of(one, mesh))
            put_distance(address, number, wp.where(value < 0.0, -distance, distance))
            note_searched(out, number, slot)
        number = number + step


def mend_slab(tree: Tree, slab: Slab, out: Output, threads: int) -> None:
    """Search for the distances of the voxels that were missed, if there are any: those that are infinite."""
    launch(_mend, threads, [tree, slab, threads, out], out.values.device, smallest=1)
