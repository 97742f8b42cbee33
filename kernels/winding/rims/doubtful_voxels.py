"""Voxels that boxes have left in doubt, by the sum over all caps, or all boundary edges: in float32, then in float64.

The lanes of a group share caps or edges, and the voxels of a box of 2^3 between them. The winding number of the surface
is that of surface and caps less the caps' share (`all_caps`), or that of its crossings plus the boundary's
(`float32_sum`). Where the error of that leaves the side open, float64's sum over all boundary edges is taken, which has
the crossings of the caps by the ray along x taken away: so every voxel is on the side where that is.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.geometry.voxel_grid import Slab, unravel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    ballot,
    bit_at,
    bits_of_lanes,
    first_member,
    from_lane,
    int_from_lane,
    one_on_cpu,
    sum_of_lanes_in_double,
    sum_of_some,
    unknown,
    wait_for_lanes,
)
from sdm.kernels.winding.all_caps import cap_part
from sdm.kernels.winding.boundary_term import Boundary, boundary_part, edges_of
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.rims.float32_sum import rim_part
from sdm.kernels.winding.rims.single_voxels import place_of_voxel, without_caps
from sdm.kernels.winding.settled_boxes import is_left, is_sure, opened

wp.set_module_options({"enable_backward": False})

# With more edges than this a voxel is an item of work: where float64 has to add them up, others would wait for it.
MANY = 4000


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def open_doubtful(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    surface: int,
    slab: Slab,
    bits: int,
    cells: wp.vec3i,
    fewest: int,
    boxes: wp.array(dtype=wp.int32),
    octants: wp.array(dtype=wp.int32),
    length: int,
    next_item: int,
    looked: int,
    exact: int,
    counts: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open what is left of listed boxes of 2^bits voxels along each edge, which are so many along each axis.

    Items of work are their octants in doubt, or some of the voxels of boxes of 2^3 where there are fewer than `fewest`,
    or edges are many.
    `surface` is 1 if values are the crossings of the surface alone. `length`, `next_item`, `looked` and `exact` are
    places of the counts.
    """
    lane = (begin + wp.tid()) % lanes
    share = int(8)
    # Voxels of a box of 2^3 that are looked at as different items.
    apart = int(1)
    if bits == 1:
        share = int(1)
    while apart < 8 and bits < 3 and (counts[length] * share < fewest or edges_of(boundary) > MANY):
        share = 2 * share
        apart = 2 * apart
    total = counts[length] * share
    # Boxes of 2^3 in an octant, along each edge and in all, or the box itself.
    half = wp.max(bits - 2, 0)
    item = fetch_add_once(counts, next_item, 1, lane)
    while item < total:
        number = item / share
        part_of_box = item - number * share
        mesh, at = unravel(boxes[number], cells)
        first = wp.vec3i(at[0] << bits, at[1] << bits, at[2] << bits)
        inner = 1 << (3 * half)
        # Every so many voxels.
        some = wp.where(apart == 1, 255, wp.where(apart == 2, 0x55, wp.where(apart == 4, 0x11, 1)))
        some = some << (part_of_box & (apart - 1))
        if bits > 1:
            part_of_box = part_of_box / apart
            octant = place_in_box(part_of_box, 1)
            size = bits - 1
            first = first + wp.vec3i(octant[0] << size, octant[1] << size, octant[2] << size)
            inner = wp.where((octants[number] >> part_of_box) & 1, inner, 0)
        for cell in range(inner):
            start = first + 2 * place_in_box(cell, half)
            left = int(0)
            for k in range(unknown(8)):
                # Each lane has a look at one of them; a CPU's only one at all.
                if k % lanes == lane and is_left(slab, values, mesh, start + place_in_box(k, 1)):
                    left = left | (1 << k)
            left = bits_of_lanes(left) & some
            wait_for_lanes()
            while left != 0:
                parts = int(1)
                while parts < lanes and bit_at(left, parts) < 8:
                    parts = 2 * parts
                parts = one_on_cpu(parts)
                part = one_on_cpu(lanes / parts)
                k = bit_at(left, lane / part)
                idle = k > 7
                v = start + place_in_box(wp.min(k, 7), 1)
                whole = float(0.0)
                winding = float(0.0)
                error = float(0.0)
                p = wp.vec3d()
                if not idle:
                    p = place_of_voxel(tree, slab, mesh, v)
                    whole = values[mesh, v[0], v[1], v[2]]
                    if surface == 0:
                        found = cap_part(caps, mesh, wp.vec3(p), lane & (part - 1), part)
                        winding = -found[0]
                        error = found[1]
                    else:
                        found = rim_part(boundary, mesh, wp.vec3(p), lane & (part - 1), part)
                        winding = found[0]
                        error = found[1]
                winding = sum_of_some(winding, part)
                error = sum_of_some(error, part)
                sure = bool(True)
                if not idle:
                    winding = winding + whole
                    sure = is_sure(winding, whole, error)
                wait_for_lanes()
                if not idle and sure and (lane & (part - 1)) == 0:
                    values[mesh, v[0], v[1], v[2]] = opened(winding)
                    fetch_add(counts, looked, 1)
                again = ballot(not sure and (lane & (part - 1)) == 0)
                while again != wp.uint32(0):
                    source = first_member(again)
                    again = again & (again - wp.uint32(1))
                    u = start + place_in_box(int_from_lane(k, source), 1)
                    here = place_of_voxel(tree, slab, mesh, u)
                    share_there = sum_of_lanes_in_double(boundary_part(boundary, tree, mesh, here, lane, lanes))
                    last = from_lane(whole, source)
                    if surface == 0:
                        last = without_caps(tree, caps, mesh, here, last)
                    last = last + float(share_there)
                    if lane == 0:
                        values[mesh, u[0], u[1], u[2]] = last
                        fetch_add(counts, looked, 1)
                        fetch_add(counts, exact, 1)
                for _part in range(unknown(parts)):
                    left = left & (left - 1)
        item = fetch_add_once(counts, next_item, 1, lane)
