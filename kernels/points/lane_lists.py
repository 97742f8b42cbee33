"""Lists of lanes: from a packet's list of triangles to those that matter to the point that each lane has.

Each lane reads a triangle's bounds and shows them to all others, so that the memory is asked once for each triangle,
not once for each triangle and point; what a lane keeps for its own point goes to its own column of the scratch.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import moved_square, room_at, slot_part
from sdm.kernels.bvh.tree import Tree
from sdm.kernels.points.group_descent import FOUND, OWN, OWN_ROOM, SQUARES, TIES, TIES_ROOM
from sdm.kernels.primitives.lane_broadcast import (
    broadcast,
    broadcast_around,
    broadcast_buffer,
    broadcast_ints,
    broadcast_within,
    nearest_of_broadcast,
)
from sdm.kernels.primitives.lanes import ballot, first_member
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.winding.ray_crossings import lattice_box

wp.set_module_options({"enable_backward": False})

# From one of those that tie to its squared distance.
_TO_SQUARE = SQUARES - TIES


@wp.func
def own(at: int, k: int, lane: int, lanes: int):
    """Offset in the scratch of the place that the lane's own triangle number k has in its packet's list."""
    return at + OWN + k * lanes + lane


@wp.func
def own_slot(scratch: wp.array(dtype=wp.int32), at: int, k: int, lane: int, lanes: int):
    """The slot of the lane's own triangle number k."""
    return scratch[at + FOUND + scratch[own(at, k, lane, lanes)]]


@wp.func
def nearest_middle(
    balls: wp.array(dtype=wp.float32),
    p: wp.vec3,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    found: int,
    lane: int,
    lanes: int,
):
    """Of the triangles found for a packet, the slot of one whose ball's middle is nearest to the lane's point p."""
    buffer = broadcast_buffer()
    least2 = float(wp.inf)
    place = int(0)
    first = int(0)
    while first < found:
        ball = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if first + lane < found:
            ball = load4(balls, scratch[at + FOUND + first + lane])
        broadcast(buffer, ball, lane)
        nearest = nearest_of_broadcast(buffer, wp.min(lanes, found - first), p, ball)
        if nearest[0] < least2:
            least2 = nearest[0]
            place = first + int(nearest[1])
        first = first + lanes
    return scratch[at + FOUND + place]


@wp.struct
class Ties:
    """A lane's triangles that float32 cannot tell from the nearest one so far."""

    count: wp.int32  # TIES_ROOM of them are kept
    best2: float  # squared distance of the nearest
    out2: float  # beyond which a triangle cannot be the nearest


@wp.func
def measure_kept(
    tree: Tree,
    p: wp.vec3,
    room: float,
    ties: Ties,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    kept: int,
    lane: int,
    lanes: int,
):
    """Measure the lane's own `kept` triangles from its point p (scaled), and add those that tie."""
    upcoming = int(0)
    if kept > 0:
        upcoming = own_slot(scratch, at, 0, lane, lanes)
    for k in range(kept):
        # The next one is looked up while this one is measured.
        slot = upcoming
        if k + 1 < kept:
            upcoming = own_slot(scratch, at, k + 1, lane, lanes)
        d2, part = slot_part(tree, slot, p)
        if d2 <= ties.out2:
            if d2 < ties.best2:
                ties.out2 = moved_square(d2, room)
                if ties.best2 > ties.out2:
                    # All those before are out.
                    ties.count = 0
                ties.best2 = d2
            if ties.count < TIES_ROOM:
                place = at + TIES + ties.count * lanes + lane
                scratch[place] = 4 * slot + part
                scratch[place + _TO_SQUARE] = wp.cast(d2, wp.int32)
            ties.count = ties.count + 1
    return ties


@wp.func
def keep_nearest(
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    p: wp.vec3,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    found: int,
    lane: int,
    lanes: int,
):
    """Keep for the lane those triangles found for its packet that float32 cannot tell from the nearest to p (scaled).

    Returns how many; each is four times its slot, and its nearest part as in `geometry.nearest_part`. None means that
    there was no room for all.
    """
    buffer = broadcast_buffer()
    room = room_at(p)
    ties = Ties()
    d2, _part = slot_part(tree, nearest_middle(balls, p, scratch, at, found, lane, lanes), p)
    ties.best2 = d2
    ties.out2 = moved_square(d2, room)
    # Its distance bounds that of the nearest from above.
    bound = wp.sqrt(ties.best2) + 4.0 * room
    kept = int(0)
    first = int(0)
    while first < found:
        ball = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if first + lane < found:
            ball = load4(balls, scratch[at + FOUND + first + lane])
        broadcast(buffer, ball, lane)
        near = broadcast_within(buffer, wp.min(lanes, found - first), p, bound, ball)
        while near != wp.uint32(0):
            k = first_member(near)
            near = near & (near - wp.uint32(1))
            scratch[own(at, kept, lane, lanes)] = first + k
            kept = kept + 1
        first = first + lanes
        # Before any lane's column is full, and at the end.
        if ballot(kept > OWN_ROOM - lanes) != wp.uint32(0) or first >= found:
            ties = measure_kept(tree, p, room, ties, scratch, at, kept, lane, lanes)
            bound = wp.sqrt(ties.best2) + 4.0 * room
            kept = 0
    if ties.count > TIES_ROOM:
        return 0
    left = int(0)
    for k in range(ties.count):
        place = at + TIES + k * lanes + lane
        if wp.cast(scratch[place + _TO_SQUARE], wp.float32) <= ties.out2:
            scratch[at + TIES + left * lanes + lane] = scratch[place]
            left = left + 1
    return left


@wp.func
def keep_covering(
    tree: Tree,
    q: wp.vec2i,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    found: int,
    lane: int,
    lanes: int,
):
    """Keep for the lane those triangles found for its packet that the ray along x at its q (on the lattice) may meet.

    Returns how many there are; OWN_ROOM of them are kept.
    """
    buffer = broadcast_buffer()
    kept = int(0)
    first = int(0)
    while first < found:
        box = wp.vec4i(0, 0, 0, 0)
        if first + lane < found:
            low, high = lattice_box(tree, scratch[at + FOUND + first + lane])
            box = wp.vec4i(low[0], low[1], high[0], high[1])
        broadcast_ints(buffer, box, lane)
        around = broadcast_around(buffer, wp.min(lanes, found - first), q, box)
        while around != wp.uint32(0):
            k = first_member(around)
            around = around & (around - wp.uint32(1))
            if kept < OWN_ROOM:
                scratch[own(at, kept, lane, lanes)] = first + k
            kept = kept + 1
        first = first + lanes
    return kept
