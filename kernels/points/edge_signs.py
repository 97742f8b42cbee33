"""Signs of scattered points near an open mesh's holes: by the sum over all of its boundary edges.

In float32 with a bound first, and in float64 where that leaves a doubt, so that each point is on the side where
float64's sum is. All lanes of a group share the edges of one point after the other: a lane that goes through them, or
down a tree of dipoles, by itself takes milliseconds for a point.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.launch import launch
from sdm.kernels.points.packets import FAR, PACKET, Packets, is_finite, numbered, packet_end, scale_of
from sdm.kernels.points.signs import INSIDE, OUTSIDE
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    GPU_LANES,
    ballot,
    first_member,
    int_from_lane,
    sum_of_lanes,
    sum_of_lanes_in_double,
)
from sdm.kernels.primitives.wide_numbers import SIXTEEN
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.eights.packed_edges import ROW, pack_edges, sum_of_eights
from sdm.kernels.winding.ray_crossings import count_crossings
from sdm.kernels.winding.rims.float32_sum import rim_part
from sdm.kernels.winding.settled_boxes import LAST_ROUNDING, LAST_ROUNDINGS
from sdm.kernels.winding.winding_number import DIRTY, MANY, OPEN

wp.set_module_options({"enable_backward": False})

# Of more boundary edges the tree of dipoles costs less.
MOST_SUMMED = {"cuda": 1 << 15, "cpu": 1 << 14}
# Groups of lanes that share a packet's points on a GPU: a few thousand points are to keep all of it busy. Of more
# packets than this each has one, as threads are counted with 32 bits.
PARTS, MOST_PARTED = 8, 1 << 20


@wp.func
def is_inside(
    tree: Tree,
    boundary: Boundary,
    rows: wp.array(dtype=wp.float32),
    first: int,
    packed: int,
    p: wp.vec3d,
    crossings: int,
    lane: int,
    lanes: int,
):
    """True if the winding number at p (scaled), of a mesh alone, is more than 0.5; all lanes are told."""
    whole = float(crossings)
    found = wp.vec2()
    if packed > 0:
        found = sum_of_eights(rows, first, packed, wp.vec3(p))
    else:
        found = rim_part(boundary, 0, wp.vec3(p), lane, lanes)
    winding = whole + sum_of_lanes(found[0])
    error = sum_of_lanes(found[1]) + LAST_ROUNDINGS + LAST_ROUNDING * wp.abs(whole)
    # Nor if the error is infinite, or nothing that can be compared.
    if not wp.abs(winding - 0.5) > error:
        exact = sum_of_lanes_in_double(boundary_part(boundary, tree, 0, p, lane, lanes))
        winding = float(wp.float64(crossings) + exact)
    return winding > 0.5


@wp.func
def sign_part(
    tree: Tree,
    boundary: Boundary,
    rows: wp.array(dtype=wp.float32),
    first_row: int,
    packed: int,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    packet: int,
    part: int,
    parts: int,
    sides: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    """Write the sides of one of so many parts of a packet's points, of a mesh alone.

    `packed` of its edges are in `rows` from `first_row` on (`eights.packed_edges`); 0: they are not packed.
    """
    first = PACKET * packet + part * (PACKET / parts)
    end = wp.min(first + PACKET / parts, packet_end(packets, packet))
    scale = scale_of(tree, 0)
    while first < end:
        at = first + lane
        i = int(-1)
        crossings = int(0)
        if at < end:
            i = numbered(order, at)
            if i >= 0:
                if is_finite(points[i]):
                    crossings = count_crossings(tree, 0, scale * wp.vec3d(points[i]))
                else:
                    i = -1
        left = ballot(i >= 0)
        while left != wp.uint32(0):
            source = first_member(left)
            left = left & (left - wp.uint32(1))
            p = scale * wp.vec3d(points[int_from_lane(i, source)])
            known = int_from_lane(crossings, source)
            inside = is_inside(tree, boundary, rows, first_row, packed, p, known, lane, lanes)
            if lane == source:
                sides[at] = wp.where(inside, INSIDE, OUTSIDE)
        first = first + lanes


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def _sign_by_edges(
    begin: int,
    lanes: int,
    parts: int,
    tree: Tree,
    boundary: Boundary,
    rows: wp.array(dtype=wp.float32),
    packed: wp.array(dtype=wp.int32),
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    sides: wp.array(dtype=wp.int32),
):
    """Each group of lanes has one of so many parts of a packet, unless lists tell the sides of that."""
    thread = begin + wp.tid()
    group = thread / lanes
    packet = group / parts
    if (packets.hints[packet] & FAR) != 0:
        return
    count = int(0)
    if packed.shape[0] > 0:
        count = packed[0]
    sign_part(
        tree, boundary, rows, 0, count, points, order, packets, packet, group - packet * parts, parts, sides,
        thread % lanes, lanes,
    )  # fmt: skip


def lanes_and_parts(packets: int, gpu: bool) -> tuple[int, int]:
    """Lanes of a group, and groups that share each of so many packets."""
    return (GPU_LANES, PARTS if packets <= MOST_PARTED else 1) if gpu else (1, 1)


def is_summed(kind: int, edges: int, gpu: bool) -> bool:
    """True if points near the holes of a mesh with so many boundary edges are signed by the sum over all of them."""
    return kind in (OPEN, MANY, DIRTY) and edges <= MOST_SUMMED["cuda" if gpu else "cpu"]


def sign_by_edges(
    tree: Tree,
    boundary: Any,
    points: wp.array,
    order: wp.array,
    packets: Packets,
    sides: wp.array,
    empty: Callable[[int, Any], wp.array],
) -> None:
    """Write INSIDE or OUTSIDE for the finite points of packets that are not far from the holes; for others nothing.

    Args:
        tree: The hierarchy of one mesh.
        boundary: Its boundary edges.
        points: (N,) vec3.
        order: (N,) the order to go through them, or empty.
        packets: What is known of them.
        sides: (N,) int32, in that order.
        empty: Allocates workspace: `empty(length, dtype)`.
    """
    device = points.device
    lanes, parts = lanes_and_parts(packets.count, device.is_cuda)
    # A CPU sums edges up by sixteens.
    blocks = 0 if device.is_cuda else -(-boundary.count // SIXTEEN)
    rows, packed = empty(ROW * blocks, wp.float32), empty(min(blocks, 1), wp.int32)
    if blocks:
        launch(pack_edges, 1, [boundary, blocks, rows, packed], device)
    inputs = [lanes, parts, tree, boundary, rows, packed, points, order, packets, sides]
    launch(_sign_by_edges, packets.count * parts * lanes, inputs, device, smallest=1)
