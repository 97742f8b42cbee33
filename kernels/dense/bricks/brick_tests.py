"""Tests of features for the bricks of a cell of 16^3 voxels, and the bricks' witnesses.

As a block's octants are found in `octant_tests`, by linear tests of which eight boxes are steps of one lattice. The
witness of all these tests is the cell's. Points of the features that are looked at are witnesses of the bricks to whose
centres they are nearest: stage 6 drops more by them.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, load_corners
from sdm.kernels.culling.voronoi_features import Features, last_of_row, load_feature_row, one_of
from sdm.kernels.culling.witness_bound import (
    Witness,
    bulge_of_edge,
    doubt,
    no_witness,
    reach,
    read_witness_in_use,
    write_witness,
)
from sdm.kernels.dense.block.feature_setup import directions_of_corner, directions_of_edge
from sdm.kernels.dense.block.octant_tests import bricks_of, room_for, test_direction
from sdm.kernels.dense.block.shared_layout import SCRATCH_ROWS, TEST_ROW, WITNESS_ROW, read_row, write_row
from sdm.kernels.dense.bricks.brick_chains import BRICKS
from sdm.kernels.dense.cell_cache import CellCache, cached_box
from sdm.kernels.dense.region_grid import BLOCK, RegionGrid, brick_number
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.primitives.lanes import GPU_GROUPS, ballot, lane_of_least, members, unknown, wait_for_lanes

wp.set_module_options({"enable_backward": False})

# So many times the room for rounding that tests of a block's octants have: what these keep is in the list of its block,
# and so values have the bits that they have by a list of all features. That is not so of what an inequality just drops:
# next to an edge a face and the edge are as far to within rounding.
MORE_ROOM = 1.5
# Of the layout of `shared_layout` what tests need, and after it each brick's centre and the square of how far its
# witness is; then the witnesses that were found, with 1 in the fourth place.
CENTRE_ROW = WITNESS_ROW + 1
KNOWN_ROW = CENTRE_ROW + BRICKS
HALF_ROW = KNOWN_ROW + BRICKS
_ROWS = HALF_ROW + BRICKS - TEST_ROW


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{GPU_GROUPS} * {_ROWS}];
    return (wp::uint64)(shared + threadIdx.x / 32 * {_ROWS}) - {16 * TEST_ROW};
#else
    return (wp::uint64)(scratch.data + 4 * (size_t)worker * {SCRATCH_ROWS});
#endif
"""
)
def test_scratch_of(scratch: wp.array(dtype=wp.float32), worker: int) -> wp.uint64:
    """The address of a worker's rows, of which there are those from the tests on alone."""
    ...


@wp.func
def bricks_in_slab(slab: Slab, start: wp.vec3i):
    """The bricks of a cell, as bits, that have voxels."""
    there = int(255)
    if start[0] + BLOCK >= slab.shape[0]:
        there = there & 15
    if start[1] + BLOCK >= slab.shape[1]:
        there = there & 51
    if start[2] + BLOCK >= slab.shape[2]:
        there = there & 85
    return there


@wp.func
def write_brick_witness(scratch: wp.uint64, brick: int, known: Witness, half: wp.vec3, diagonal: float, found: float):
    """Write a brick's witness, and what rounding may take from what is compared with it; see `witness_bound`."""
    u = known.to_surface
    box = VoxelBox()
    box.half = half
    box.half2 = wp.dot(half, half)
    box.diagonal = diagonal
    write_row(scratch, KNOWN_ROW + brick, u[0], u[1], u[2], known.distance2 + doubt(box, known))
    write_row(scratch, HALF_ROW + brick, half[0], half[1], half[2], found)


@wp.func
def begin_witnesses(
    scratch: wp.uint64,
    grid: RegionGrid,
    cache: CellCache,
    number: int,
    centre: wp.vec3,
    there: int,
    lane: int,
    lanes: int,
):
    """Write the boxes of a cell's bricks, seen from its centre, and the witnesses that stage 4 has noted."""
    brick = lane
    while brick < BRICKS:
        number_of = brick_number(grid, number, brick)
        box = cached_box(cache, number_of).box
        off = box.centre - centre
        known = no_witness()
        # None is found for bricks without voxels.
        distance2 = float(0.0)
        if ((there >> brick) & 1) != 0:
            known = read_witness_in_use(cache.witnesses, grid.count + number_of)
            distance2 = known.distance2
        write_row(scratch, CENTRE_ROW + brick, off[0], off[1], off[2], distance2)
        write_brick_witness(scratch, brick, known, box.half, box.diagonal, 0.0)
        brick = brick + lanes


@wp.func
def compare_points(scratch: wp.uint64, is_point: bool, q: wp.vec3, radius2: float, diagonal: float, lane: int):
    """The bricks, as bits, to some voxel of which a feature within a ball around q may be nearer than their witnesses.

    q is a point of it, seen from the cell's centre, and is taken for the witness of the bricks to whose centres it is
    the nearest of all so far.
    """
    which = int(0)
    bricks = unknown(BRICKS)
    for brick in range(bricks):
        row = read_row(scratch, CENTRE_ROW + brick)
        off = wp.vec3(row[0], row[1], row[2]) - q
        distance2 = wp.dot(off, off)
        if members(ballot(is_point and distance2 < row[3])) > 0:
            half = read_row(scratch, HALF_ROW + brick)
            wait_for_lanes()
            if lane == lane_of_least(wp.where(is_point, distance2, float(wp.inf)), lane):
                write_row(scratch, CENTRE_ROW + brick, row[0], row[1], row[2], distance2)
                known = Witness()
                known.to_surface = off
                known.distance2 = distance2
                write_brick_witness(scratch, brick, known, wp.vec3(half[0], half[1], half[2]), diagonal, 1.0)
            wait_for_lanes()
        known_row = read_row(scratch, KNOWN_ROW + brick)
        half = read_row(scratch, HALF_ROW + brick)
        across = wp.vec3(known_row[0], known_row[1], known_row[2]) - off
        least = distance2 - 2.0 * reach(wp.vec3(half[0], half[1], half[2]), across)
        if not (least > known_row[3] + radius2):
            which = which | (1 << brick)
    return which


@wp.func
def end_witnesses(scratch: wp.uint64, grid: RegionGrid, cache: CellCache, number: int, lane: int, lanes: int):
    """Note the bricks' witnesses that were found. Of several groups that find some any may be the last."""
    brick = lane
    while brick < BRICKS:
        if read_row(scratch, HALF_ROW + brick)[3] > 0.0:
            u = read_row(scratch, KNOWN_ROW + brick)
            known = Witness()
            known.to_surface = wp.vec3(u[0], u[1], u[2])
            known.distance2 = read_row(scratch, CENTRE_ROW + brick)[3]
            write_witness(cache.witnesses, grid.count + brick_number(grid, number, brick), known)
        brick = brick + lanes


@wp.func
def write_tests(scratch: wp.uint64, lane: int, tree: Tree, features: Features, feature: int, box: VoxelBox):
    """Write the directions of a feature as tests of a cell's bricks.

    Returns the middle of the feature, from the cell's centre, the square of a radius around that which it is within,
    and how many tests there are.
    """
    slot = feature >> 3
    which = feature & 7
    first, second, third, normal = load_corners(tree, slot)
    point = wp.vec3()
    radius2 = float(0.0)
    tests = int(3)
    if which < 3:
        one_more = last_of_row(features, slot, 1)
        r3 = load_feature_row(features, slot, 3)
        r4 = load_feature_row(features, slot, 4)
        r5 = load_feature_row(features, slot, 5)
        corner = one_of(which, first, second, third)
        point = corner - box.centre
        directions_of_corner(
            scratch,
            lane,
            box,
            which,
            first,
            second,
            third,
            wp.vec3(r3[0], r3[1], r3[2]),
            wp.vec3(r4[0], r4[1], r4[2]),
            wp.vec3(r5[0], r5[1], r5[2]),
            one_more,
            wp.vec3(r3[3], r4[3], r5[3]),
            MORE_ROOM,
        )
        tests = int(5)
    elif which < 6:
        k = which - 3
        inward = load_feature_row(features, slot, k)
        begin = one_of(k, first, second, third)
        end = one_of(k, second, third, first)
        directions_of_edge(scratch, lane, box, begin, end, normal, wp.vec3(inward[0], inward[1], inward[2]), MORE_ROOM)
        point = 0.5 * ((begin - box.centre) + (end - box.centre))
        radius2 = bulge_of_edge(end - begin)
        tests = int(4)
    else:
        a = first - box.centre
        b = second - box.centre
        c = third - box.centre
        ab = second - first
        bc = third - second
        ca = first - third
        # Not from the ball that is known: the middle is rounded by its distance from the centre alone.
        from_a = (2.0 * ab + bc) * (1.0 / 3.0)
        from_b = from_a - ab
        from_c = from_b - bc
        radius2 = 1.000001 * wp.max(wp.dot(from_a, from_a), wp.max(wp.dot(from_b, from_b), wp.dot(from_c, from_c)))
        point = a + from_a
        # On the inner side of the planes on its edges.
        test_direction(scratch, 0, lane, MORE_ROOM * room_for(box, a), a, -wp.cross(normal, ab))
        test_direction(scratch, 1, lane, MORE_ROOM * room_for(box, b), b, -wp.cross(normal, bc))
        test_direction(scratch, 2, lane, MORE_ROOM * room_for(box, c), c, -wp.cross(normal, ca))
    return point, radius2, tests


@wp.func
def bricks_that_matter(
    scratch: wp.uint64, tree: Tree, features: Features, box: VoxelBox, feature: int, taken: int, lane: int
):
    """The bricks of a cell, as bits, that the lanes' features matter to, of which there are so many."""
    which = int(0)
    point = wp.vec3()
    radius2 = float(0.0)
    if lane < taken:
        point, radius2, tests = write_tests(scratch, lane, tree, features, feature, box)
        which = bricks_of(scratch, lane, tests)
    return which & compare_points(scratch, lane < taken, point, radius2, box.diagonal, lane)
