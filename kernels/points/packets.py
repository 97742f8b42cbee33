"""Packets of neighbouring points, which share most of the work of a query, as rays do in packet traversal.

Points are sorted along the tree's curve, so that neighbours follow each other, and each run of them is a packet. Where
meshes differ, each has packets of its own: the order has places without a point at the end of the last of them. Of a
packet this file keeps the box around its points (`VoxelBox`); the triangle nearest to its centre;
and what can be said about the signs of all its points at once (see `hole_caps` for open meshes).
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_hit, nearest_slot
from sdm.kernels.bvh.tree import DIAGONAL, FRAME_SIZE, SCALE, Tree, slots_of, tree_of
from sdm.kernels.culling.witness_bound import no_witness, write_witness
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_rows
from sdm.kernels.launch import launch
from sdm.kernels.points.group_descent import SCRATCH
from sdm.kernels.points.group_search import nearest_together
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import least_of_lanes, on_cpu
from sdm.kernels.primitives.vector_loads import load4, write4
from sdm.kernels.winding.hole_caps import is_far, may_cover, view_caps
from sdm.kernels.winding.winding_number import CLOSED, MANY, OPEN, Winding

wp.set_module_options({"enable_backward": False})

# Points of a packet.
PACKET = 32
# Thread blocks that a multiprocessor of a GPU holds: the kernels of points wait for memory as much as they work.
POINT_BLOCKS_PER_SM = 5
# What a packet's hints say. Its holes are so far away that they do not decide about sides; the line along x through it
# may meet what closes them; the surface does not come into its box, so that all its points are on one side of it.
FAR, COVERED, APART = 1, 2, 4
# Places of the shared counts.
NEXT_BOX, NEXT_LIST, NEXT_SIDE, COUNTS = range(4)
# Room for rounding in the distance from a box's centre and its radius.
ROOM = 1.0e-5


@wp.struct
class Packets:
    """Boxes, witnesses and hints of `count` packets of points."""

    boxes: wp.array(dtype=wp.float32)  # (count * 8) of each box its `VoxelBox`: centre (3), half2, half (3), diagonal
    witnesses: wp.array(dtype=wp.float32)  # (count * 4) the surface point nearest to the centre, see `Witness`
    nearest: wp.array(dtype=wp.int32)  # (count) the slot of the triangle that it is on
    hints: wp.array(dtype=wp.int32)  # (count)
    count: wp.int32
    places: wp.int32  # of the order: as many as points, and where meshes differ those without one
    meshes: wp.array(dtype=wp.int32)  # (count) the mesh that each packet asks about; empty if there is one
    counts: wp.array(dtype=wp.int32)  # (COUNTS) which packet each stage takes next, zero at the start


@wp.func
def is_finite(p: wp.vec3):
    return wp.isfinite(p[0]) and wp.isfinite(p[1]) and wp.isfinite(p[2])


@wp.func
def numbered(order: wp.array(dtype=wp.int32), at: int):
    """Number of the point at a place in the order, -1 for none; the order may be empty: as they come."""
    if order.shape[0] > 0:
        return order[at]
    return at


@wp.func
def packet_end(packets: Packets, packet: int):
    """One past the last of a packet's places in the order."""
    return wp.min(PACKET * (packet + 1), packets.places)


@wp.func
def mesh_of(packets: Packets, packet: int):
    """The mesh that a packet asks about."""
    mesh = int(0)
    if packets.meshes.shape[0] > 0:
        mesh = packets.meshes[packet]
    return mesh


@wp.func
def scale_of(tree: Tree, mesh: int):
    """The factor from a mesh's unit to scaled coordinates."""
    return tree.frame[mesh * FRAME_SIZE + SCALE]


@wp.func
def point_or_middle(
    tree: Tree,
    mesh: int,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    at: int,
    end: int,
    box: VoxelBox,
):
    """The point at a place before `end`, scaled; without one, or if it is not finite, its packet's middle."""
    p = wp.vec3d(box.centre)
    if at < end:
        i = numbered(order, at)
        if i >= 0:
            point = points[i]
            if is_finite(point):
                p = scale_of(tree, mesh) * wp.vec3d(point)
    return p


@wp.func
def box_around(
    tree: Tree,
    mesh: int,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    packet: int,
    lane: int,
    lanes: int,
):
    """The box around a packet's finite points, scaled; without any, or where it is not finite, at the origin."""
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    negated_high = low
    at = PACKET * packet + lane
    while at < packet_end(packets, packet):
        i = numbered(order, at)
        if i >= 0:
            if is_finite(points[i]):
                p = float(scale_of(tree, mesh)) * points[i]
                low = wp.min(low, p)
                negated_high = wp.min(negated_high, -p)
        at = at + lanes
    low = wp.vec3(least_of_lanes(low[0]), least_of_lanes(low[1]), least_of_lanes(low[2]))
    high = -wp.vec3(least_of_lanes(negated_high[0]), least_of_lanes(negated_high[1]), least_of_lanes(negated_high[2]))
    box = VoxelBox()
    box.diagonal = float(tree.frame[mesh * FRAME_SIZE + DIAGONAL])
    box.centre = 0.5 * low + 0.5 * high
    if is_finite(box.centre):
        # A rounding more than the points need, so that none sticks out.
        box.half = wp.max(high - box.centre, box.centre - low) * 1.000001
        box.half2 = wp.dot(box.half, box.half)
    else:
        box.centre = wp.vec3(0.0, 0.0, 0.0)
        box.half2 = float(wp.inf)
    return box


@wp.func
def read_box(packets: Packets, packet: int):
    """A packet's box; `half2` is infinite if there is none."""
    return box_of_rows(load4(packets.boxes, 2 * packet), load4(packets.boxes, 2 * packet + 1))


@wp.kernel
def _look_around(
    begin: int,
    lanes: int,
    tree: Tree,
    winding: Winding,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    scratch: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    packet = fetch_add_once(packets.counts, NEXT_BOX, 1, lane)
    while packet < packets.count:
        mesh = mesh_of(packets, packet)
        box = box_around(tree, mesh, points, order, packets, packet, lane, lanes)
        slot = int(-1)
        if on_cpu():
            slot = nearest_slot(tree_of(tree, mesh), mesh, box.centre, slots_of(tree_of(tree, mesh), mesh))
        else:
            slot = nearest_together(tree_of(tree, mesh), box.centre, scratch, (thread / lanes) * SCRATCH, lane, lanes)
        known = no_witness()
        hint = int(0)
        if winding.kind == CLOSED:
            hint = FAR
        if box.half2 < float(wp.inf):
            hit = exact_hit(tree, slot, wp.vec3d(box.centre))
            known.to_surface = wp.vec3(wp.vec3d(box.centre) - hit.point)
            known.distance2 = float(hit.distance2)
            if winding.kind == OPEN or winding.kind == MANY:
                if is_far(view_caps(winding.caps, winding.boundary, 0, box, lane, lanes)):
                    hint = FAR + wp.where(may_cover(winding.caps, 0, box, lane, lanes), COVERED, 0)
            if wp.sqrt(known.distance2) > wp.sqrt(box.half2) * (1.0 + ROOM) + ROOM * wp.length(box.centre):
                hint = hint + APART
        if lane == 0:
            half = box.half
            write4(packets.boxes, 2 * packet, box.centre[0], box.centre[1], box.centre[2], box.half2)
            write4(packets.boxes, 2 * packet + 1, half[0], half[1], half[2], box.diagonal)
            write_witness(packets.witnesses, packet, known)
            packets.nearest[packet] = slot
            packets.hints[packet] = hint
        packet = fetch_add_once(packets.counts, NEXT_BOX, 1, lane)


def look_around(
    tree: Tree,
    winding: Winding,
    points: wp.array,
    order: wp.array,
    packets: Packets,
    scratch: wp.array,
    workers: int,
    lanes: int,
) -> None:
    """Fill `packets` for points (N,) in their order, or as they come if `order` is empty.

    `workers` groups of lanes are at work; `packets.counts` must be zero; `scratch` has room for workers * SCRATCH.
    """
    inputs = [lanes, tree, winding, points, order, packets, scratch]
    launch(_look_around, workers * lanes, inputs, points.device, smallest=1)
