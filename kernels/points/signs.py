"""Signs of scattered points: each packet's list of triangles that rays along x from its points may meet.

Where a whole number of crossings tells the side (a closed mesh, or a packet far from an open one's holes), all points
of a packet use one list; where the surface does not come into the packet's box, they are on one side of it, that of
its centre. Elsewhere each point has its own winding number, which is not found here.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, node_box, nodes_of, to_lattice, tree_of
from sdm.kernels.culling.witness_bound import LARGEST_SQUARE
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.launch import launch
from sdm.kernels.points.candidates import gather_on_rays
from sdm.kernels.points.group_descent import OWN_ROOM, SCRATCH
from sdm.kernels.points.lane_lists import keep_covering, own_slot
from sdm.kernels.points.packets import (
    APART,
    COVERED,
    FAR,
    NEXT_SIDE,
    PACKET,
    POINT_BLOCKS_PER_SM,
    Packets,
    mesh_of,
    packet_end,
    point_or_middle,
    read_box,
)
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import wait_for_lanes
from sdm.kernels.winding.ray_crossings import (
    count_crossings,
    count_on_ray,
    crossing_on_ray,
    ray_from,
    winding_of_closed,
)
from sdm.kernels.winding.winding_number import Winding

wp.set_module_options({"enable_backward": False})

UNKNOWN, OUTSIDE, INSIDE = 0, 1, 2
# Room for rounding, of coordinates to float32 and to the rays' lattice, in what two balls cover: a share, and scaled.
BALLS, BALL_ROOM = wp.constant(wp.float64(1.0 - 1.0e-5)), wp.constant(wp.float64(1.0e-6))


@wp.func
def list_rays(
    tree: Tree,
    mesh: int,
    box: VoxelBox,
    back: bool,
    scratch: wp.array(dtype=wp.int32),
    room: int,
    lane: int,
    lanes: int,
):
    """`gather_on_rays` for all points of a box."""
    low = wp.vec3d(box.centre - box.half)
    high = wp.vec3d(box.centre + box.half)
    ray = ray_from(low, back)
    other = ray_from(high, back)
    ray.high_y = other.high_y
    ray.high_z = other.high_z
    if back:
        ray.x = other.x
    return gather_on_rays(
        tree,
        ray,
        to_lattice(tree, mesh, low[1], low[2]),
        to_lattice(tree, mesh, high[1], high[2]),
        scratch,
        room,
        lane,
        lanes,
    )


@wp.func
def crossings_in_list(
    tree: Tree,
    mesh: int,
    p: wp.vec3d,
    back: bool,
    scratch: wp.array(dtype=wp.int32),
    room: int,
    found: int,
    lane: int,
    lanes: int,
):
    """`count_on_ray` from the lane's p (scaled), of the triangles found for its packet."""
    q = to_lattice(tree, mesh, p[1], p[2])
    kept = keep_covering(tree, q, scratch, room, found, lane, lanes)
    if kept > OWN_ROOM:
        return count_on_ray(tree_of(tree, mesh), mesh, p, back)
    total = int(0)
    for k in range(kept):
        slot = own_slot(scratch, room, k, lane, lanes)
        total = total + crossing_on_ray(tree, slot, q, p[0], back)
    return wp.where(back, -total, total)


@wp.func
def inside_by_rays(
    tree: Tree,
    mesh: int,
    p: wp.vec3d,
    radius: wp.float64,
    before: wp.vec3d,
    reach: wp.float64,
    before_inside: bool,
):
    """True where p (scaled), so far from the surface, is inside as rays tell; the point before had such a side."""
    # Two balls that meet: no surface is between their centres.
    if wp.length(p - before) < (reach + radius) * BALLS - BALL_ROOM:
        return before_inside
    return winding_of_closed(tree, mesh, p) > 0


@wp.func
def sides_of_packet(
    tree: Tree,
    mesh: int,
    caps: Tree,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    packet: int,
    scratch: wp.array(dtype=wp.int32),
    room: int,
    sides: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    """Fill a packet's sides, of points of a mesh of the tree whose holes have these caps."""
    low, high = node_box(tree, nodes_of(tree_of(tree, mesh), mesh) + 1)
    box = read_box(packets, packet)
    hint = packets.hints[packet]
    covered = (hint & COVERED) != 0
    apart = (hint & APART) != 0
    back = low[0] + high[0] > 2.0 * box.centre[0] and not covered
    found = int(-1)
    if (hint & FAR) != 0 and box.half2 < LARGEST_SQUARE:
        if apart:
            box.half = wp.vec3(0.0, 0.0, 0.0)
        found = list_rays(tree_of(tree, mesh), mesh, box, back, scratch, room, lane, lanes)
    end = packet_end(packets, packet)
    first = PACKET * packet
    while first < end:
        at = first + lane
        p = wp.vec3d(box.centre)
        if not apart:
            p = point_or_middle(tree, mesh, points, order, at, end, box)
        side = UNKNOWN
        if found >= 0:
            total = crossings_in_list(tree, mesh, p, back, scratch, room, found, lane, lanes)
            if covered:
                total = total + count_crossings(caps, 0, p)
            side = wp.where(total > 0, INSIDE, OUTSIDE)
        if at < end:
            sides[at] = side
        first = first + lanes
    # The scratch is read until here.
    wait_for_lanes()


@wp.kernel(launch_bounds=(128, POINT_BLOCKS_PER_SM))
def _find_sides(
    begin: int,
    lanes: int,
    tree: Tree,
    winding: Winding,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    scratch: wp.array(dtype=wp.int32),
    sides: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    room = (thread / lanes) * SCRATCH
    packet = fetch_add_once(packets.counts, NEXT_SIDE, 1, lane)
    while packet < packets.count:
        mesh = mesh_of(packets, packet)
        sides_of_packet(
            tree, mesh, winding.caps.tree, points, order, packets, packet, scratch, room, sides, lane, lanes
        )
        packet = fetch_add_once(packets.counts, NEXT_SIDE, 1, lane)


def find_sides(
    tree: Tree,
    winding: Winding,
    points: wp.array,
    order: wp.array,
    packets: Packets,
    scratch: wp.array,
    sides: wp.array,
    workers: int,
    lanes: int,
) -> None:
    """Fill `sides` (N,), in their order, with INSIDE, OUTSIDE or UNKNOWN for each of points (N,).

    `workers` groups of lanes are at work; `scratch` has room for workers * SCRATCH.
    """
    inputs = [lanes, tree, winding, points, order, packets, scratch, sides]
    launch(_find_sides, workers * lanes, inputs, points.device, smallest=1)
