"""Second stage of the dense query: bricks of 4^3 voxels, and the distances themselves.

One group of lanes takes one brick. It filters the list of the brick's cell once more, for the brick alone, lists the
parts of the triangles that are left, and measures the brick's voxels from those.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cells import CHUNK, NEXT_BRICK, ROOM, Lists, cell_start, make_cell
from sdm.kernels.cull import Cell, agree, away, no_witness, remember, triangle_is_behind
from sdm.kernels.features import (
    NEAR_ENDS,
    Counts,
    Features,
    add_features,
    are_full,
    is_near,
    least_distance,
    least_values,
)
from sdm.kernels.frames import load_frame, see
from sdm.kernels.grid import Output, Slab, voxel, write_distance
from sdm.kernels.lanes import fetch_add, fetch_add_once, wait_for_lanes
from sdm.kernels.parts import Parts, parts_that_matter
from sdm.kernels.tree import FRAME_SIZE, SCALE, UNSCALE, Tree

wp.set_module_options({"enable_backward": False})

BRICK = wp.constant(4)
# A multiprocessor of a GPU holds so many blocks of 128 threads at a time; the compiler shares out registers by it.
BLOCKS = 4

_CHUNK = wp.constant(CHUNK)
_ROOM = wp.constant(ROOM)
_NEXT_BRICK = wp.constant(NEXT_BRICK)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)


@wp.struct
class Brick:
    """Up to 4^3 voxels of a mesh's map."""

    mesh: wp.int32
    start: wp.vec3i  # its first voxel
    cell: Cell
    radius2: float  # squared distance of its centre from the surface


@wp.func
def nearest_of_chain(
    frames: wp.array(dtype=wp.float32), lists: Lists, item: int, centre: wp.vec3, lane: int, lanes: int
):
    """The surface point nearest to a brick's centre, from its cell's list."""
    known = no_witness()
    chunk = lists.heads[item]
    left = lists.lengths[item]
    while left > 0:
        taken = wp.min(left, _ROOM)
        i = lane
        while i < taken:
            f = load_frame(frames, lists.pool[chunk * _CHUNK + i])
            known = remember(known, away(f, see(f, centre)))
            i = i + lanes
        left = left - taken
        if left > 0:
            chunk = lists.pool[chunk * _CHUNK + _ROOM]
    return agree(known, lane)


@wp.func
def local_voxel(tree: Tree, slab: Slab, brick: Brick, v: int):
    """Voxel v of a brick, from the brick's centre."""
    scale = tree.frame[brick.mesh * _FRAME_SIZE + _SCALE]
    p = voxel(slab, brick.start[0] + (v >> 4), brick.start[1] + ((v >> 2) & 3), brick.start[2] + (v & 3))
    return wp.vec3(scale * wp.vec3d(p) - wp.vec3d(brick.cell.centre))


@wp.func
def measure_voxels(
    features: Features, worker: int, counts: Counts, brick: Brick, p: wp.vec3, q: wp.vec3, v: int, again: bool
):
    """The least values of voxels v and v + 32 over the features listed now, and those before if `again`."""
    least = wp.vec2(wp.inf, wp.inf)
    if again:
        least = wp.vec2(features.least[64 * worker + v], features.least[64 * worker + v + 32])
    half = brick.cell.half
    room = NEAR_ENDS * (half[0] + half[1] + half[2])
    return least_values(least, features, worker, counts, p, q, room, is_near(brick.radius2, brick.cell.half2))


@wp.func
def finish_voxel(tree: Tree, slab: Slab, out: Output, brick: Brick, v: int, p: wp.vec3, least: float):
    """Write the distance of a voxel; 1 if its winding number is unclear."""
    i = brick.start[0] + (v >> 4)
    j = brick.start[1] + ((v >> 2) & 3)
    k = brick.start[2] + (v & 3)
    if i >= slab.shape[0] or j >= slab.shape[1] or k >= slab.shape[2]:
        return 0
    near = is_near(brick.radius2, brick.cell.half2)
    distance = least_distance(least, p, wp.float64(brick.radius2), near)
    if distance == wp.inf or distance != distance:
        # No list ever lacks the nearest part; but were it so, or did float32 overflow, the tree has the answer.
        distance = float(wp.inf)
        fetch_add(out.missed, 0, 1)
    return write_distance(out, brick.mesh, i, j, k, distance * float(tree.frame[brick.mesh * _FRAME_SIZE + _UNSCALE]))


@wp.kernel(launch_bounds=(128, BLOCKS))
def _measure_bricks(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    parts: Parts,
    slab: Slab,
    lists: Lists,
    features: Features,
    out: Output,
):
    thread = begin + wp.tid()
    lane = thread % lanes
    worker = thread / lanes
    # Eight bricks to a cell.
    item = fetch_add_once(lists.counts, _NEXT_BRICK, 1, lane)
    while item < 8 * lists.count:
        brick = Brick()
        mesh, start = cell_start(lists, item / 8)
        start = start + BRICK * wp.vec3i((item >> 2) & 1, (item >> 1) & 1, item & 1)
        if start[0] < slab.shape[0] and start[1] < slab.shape[1] and start[2] < slab.shape[2]:
            brick.mesh = mesh
            brick.start = start
            brick.cell = make_cell(slab, start, BRICK, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
            chunk = lists.heads[item / 8]
            left = int(0)
            known = no_witness()
            if chunk >= 0:
                left = lists.lengths[item / 8]
                known = nearest_of_chain(frames, lists, item / 8, brick.cell.centre, lane, lanes)
            brick.radius2 = known.distance2
            counts = Counts()
            again = bool(False)
            while left > 0:
                taken = wp.min(left, _ROOM)
                at = int(0)
                while at < taken:
                    which = int(0)
                    slot = int(0)
                    if at + lane < taken:
                        slot = lists.pool[chunk * _CHUNK + at + lane]
                        f = load_frame(frames, slot)
                        if not triangle_is_behind(brick.cell, known, f, see(f, brick.cell.centre)):
                            which = parts_that_matter(brick.cell, tree, parts, slot)
                    counts = add_features(
                        features, worker, counts, tree, parts, slot, which, brick.cell.centre, brick.radius2, lane
                    )
                    at = at + lanes
                    if are_full(counts):
                        wait_for_lanes()
                        v = lane
                        while v < 32:
                            p = local_voxel(tree, slab, brick, v)
                            q = local_voxel(tree, slab, brick, v + 32)
                            least = measure_voxels(features, worker, counts, brick, p, q, v, again)
                            features.least[64 * worker + v] = least[0]
                            features.least[64 * worker + v + 32] = least[1]
                            v = v + lanes
                        counts = Counts()
                        again = True
                        wait_for_lanes()
                left = left - taken
                if left > 0:
                    chunk = lists.pool[chunk * _CHUNK + _ROOM]
            wait_for_lanes()
            unclear = int(0)
            v = lane
            while v < 32:
                p = local_voxel(tree, slab, brick, v)
                q = local_voxel(tree, slab, brick, v + 32)
                least = measure_voxels(features, worker, counts, brick, p, q, v, again)
                unclear = unclear + finish_voxel(tree, slab, out, brick, v, p, least[0])
                unclear = unclear + finish_voxel(tree, slab, out, brick, v + 32, q, least[1])
                v = v + lanes
            wait_for_lanes()
            if unclear > 0:
                fetch_add(out.ambiguous, mesh, unclear)
        item = fetch_add_once(lists.counts, _NEXT_BRICK, 1, lane)


def measure_bricks(
    tree: Tree,
    frames: wp.array,
    parts: Parts,
    slab: Slab,
    lists: Lists,
    features: Features,
    out: Output,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Distances of every voxel of one pass; `features` is scratch.

    Voxels of cells whose list found no room become infinite with their sign, and are counted in `out.missed`.
    """
    launch(
        _measure_bricks,
        workers * lanes,
        [lanes, tree, frames, parts, slab, lists, features, out],
        frames.device,
        smallest=1,
    )
