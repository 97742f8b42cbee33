"""From a group's list of triangles to those that matter to one of its points: each lane has a point of its own.

Each lane reads a triangle's bounds and shows them to all others, so that the memory is asked once for each triangle,
not once for each triangle and point; what a lane keeps for its own point goes to its own column of the scratch.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.closest import moved_square, room_at, slot_part
from sdm.kernels.crossings import lattice_box
from sdm.kernels.descent import FOUND, OWN, OWN_ROOM, SQUARES, TIES, TIES_ROOM
from sdm.kernels.lanes import ballot, from_lane, int_from_lane, load4
from sdm.kernels.tree import Tree

wp.set_module_options({"enable_backward": False})

_FOUND, _OWN, _OWN_ROOM = wp.constant(FOUND), wp.constant(OWN), wp.constant(OWN_ROOM)
_TIES, _TIES_ROOM = wp.constant(TIES), wp.constant(TIES_ROOM)
# From one of those that tie to its squared distance.
_TO_SQUARE = wp.constant(SQUARES - TIES)


@wp.func
def own(at: int, k: int, lane: int, lanes: int):
    """Where in the scratch the lane's own triangle number k is."""
    return at + _OWN + k * lanes + lane


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
    """Of the triangles found for a group, the slot of one whose ball's middle is nearest to the lane's point p."""
    least2 = float(wp.inf)
    place = int(0)
    first = int(0)
    while first < found:
        ball = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if first + lane < found:
            ball = load4(balls, scratch[at + _FOUND + first + lane])
        for k in range(wp.min(lanes, found - first)):
            d = p - wp.vec3(from_lane(ball[0], k), from_lane(ball[1], k), from_lane(ball[2], k))
            d2 = wp.dot(d, d)
            if d2 < least2:
                least2 = d2
                place = first + k
        first = first + lanes
    return scratch[at + _FOUND + place]


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
    for k in range(kept):
        slot = scratch[own(at, k, lane, lanes)]
        d2, part = slot_part(tree, slot, p)
        if d2 <= ties.out2:
            if d2 < ties.best2:
                ties.out2 = moved_square(d2, room)
                if ties.best2 > ties.out2:
                    # All those before are out.
                    ties.count = 0
                ties.best2 = d2
            if ties.count < _TIES_ROOM:
                place = at + _TIES + ties.count * lanes + lane
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
    """Keep for the lane those triangles found for its group that float32 cannot tell from the nearest to p (scaled).

    Returns how many; each is four times its slot, and its nearest part as in `geometry.nearest_part`. None means that
    there was no room for all.
    """
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
        slot = int(0)
        if first + lane < found:
            slot = scratch[at + _FOUND + first + lane]
            ball = load4(balls, slot)
        for k in range(wp.min(lanes, found - first)):
            d = p - wp.vec3(from_lane(ball[0], k), from_lane(ball[1], k), from_lane(ball[2], k))
            reach = bound + from_lane(ball[3], k)
            other = int_from_lane(slot, k)
            # Not the opposite test: what is no number is kept.
            if not wp.dot(d, d) > reach * reach:
                scratch[own(at, kept, lane, lanes)] = other
                kept = kept + 1
        first = first + lanes
        # Before any lane's column is full, and at the end.
        if ballot(kept > _OWN_ROOM - lanes) != wp.uint32(0) or first >= found:
            ties = measure_kept(tree, p, room, ties, scratch, at, kept, lane, lanes)
            bound = wp.sqrt(ties.best2) + 4.0 * room
            kept = 0
    if ties.count > _TIES_ROOM:
        return 0
    left = int(0)
    for k in range(ties.count):
        place = at + _TIES + k * lanes + lane
        if wp.cast(scratch[place + _TO_SQUARE], wp.float32) <= ties.out2:
            scratch[at + _TIES + left * lanes + lane] = scratch[place]
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
    """Keep for the lane those triangles found for its group that the ray along x at its q (on the lattice) may meet.

    Returns how many there are; OWN_ROOM of them are kept.
    """
    kept = int(0)
    first = int(0)
    while first < found:
        slot = int(0)
        low = wp.vec2i(0, 0)
        high = wp.vec2i(0, 0)
        if first + lane < found:
            slot = scratch[at + _FOUND + first + lane]
            low, high = lattice_box(tree, slot)
        for k in range(wp.min(lanes, found - first)):
            # Each of these for all lanes: an `and` would leave some of them out.
            low_y = int_from_lane(low[0], k)
            high_y = int_from_lane(high[0], k)
            low_z = int_from_lane(low[1], k)
            high_z = int_from_lane(high[1], k)
            other = int_from_lane(slot, k)
            if q[0] >= low_y and q[0] <= high_y and q[1] >= low_z and q[1] <= high_z:
                if kept < _OWN_ROOM:
                    scratch[own(at, kept, lane, lanes)] = other
                kept = kept + 1
        first = first + lanes
    return kept
