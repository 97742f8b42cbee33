"""From a group's list of triangles to those that matter to one of its points: each lane has a point of its own.

Each lane reads a triangle's bounds and shows them to all others, so that the memory is asked once for each triangle,
not once for each triangle and point; what a lane keeps for its own point goes to its own column of the scratch.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.gather import FOUND, OWN, OWN_ROOM
from sdm.kernels.lanes import from_lane, int_from_lane, load4
from sdm.kernels.tree import Tree

wp.set_module_options({"enable_backward": False})

_FOUND, _OWN, _OWN_ROOM = wp.constant(FOUND), wp.constant(OWN), wp.constant(OWN_ROOM)


@wp.struct
class Column:
    """Where a lane's triangles are: `count` slots in the scratch from `begin`, `step` apart."""

    begin: wp.int32
    step: wp.int32
    count: wp.int32


@wp.func
def column_of(at: int, found: int, kept: int, lane: int, lanes: int):
    """The lane's own column of `kept` triangles, or, if there was no room for all, the group's whole list."""
    column = Column()
    column.begin = at + _OWN + lane
    column.step = lanes
    column.count = kept
    if kept > _OWN_ROOM:
        column.begin = at + _FOUND
        column.step = 1
        column.count = found
    return column


@wp.func
def keep_near(
    balls: wp.array(dtype=wp.float32),
    p: wp.vec3,
    room: float,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    found: int,
    lane: int,
    lanes: int,
):
    """Of the triangles found for a group, those that may be nearest to the lane's point p (scaled).

    The middle of a triangle's ball is on it, so the least distance of a middle bounds p's distance from above; a
    triangle whose ball is further away than that (and `room`, for rounding) is left out.
    """
    least2 = float(wp.inf)
    first = int(0)
    while first < found:
        ball = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if first + lane < found:
            ball = load4(balls, scratch[at + _FOUND + first + lane])
        for k in range(wp.min(lanes, found - first)):
            d = p - wp.vec3(from_lane(ball[0], k), from_lane(ball[1], k), from_lane(ball[2], k))
            least2 = wp.min(least2, wp.dot(d, d))
        first = first + lanes
    bound = wp.sqrt(least2) + 4.0 * room
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
                if kept < _OWN_ROOM:
                    scratch[at + _OWN + kept * lanes + lane] = other
                kept = kept + 1
        first = first + lanes
    return column_of(at, found, kept, lane, lanes)


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
    """Of the triangles found for a group, those that the ray along x at the lane's q (on the lattice) may meet."""
    kept = int(0)
    first = int(0)
    while first < found:
        slot = int(0)
        low = wp.vec2i(0, 0)
        high = wp.vec2i(0, 0)
        if first + lane < found:
            slot = scratch[at + _FOUND + first + lane]
            a = tree.lattice[3 * slot]
            b = tree.lattice[3 * slot + 1]
            c = tree.lattice[3 * slot + 2]
            low = wp.min(a, wp.min(b, c))
            high = wp.max(a, wp.max(b, c))
        for k in range(wp.min(lanes, found - first)):
            # Each of these for all lanes: an `and` would leave some of them out.
            low_y = int_from_lane(low[0], k)
            high_y = int_from_lane(high[0], k)
            low_z = int_from_lane(low[1], k)
            high_z = int_from_lane(high[1], k)
            other = int_from_lane(slot, k)
            if q[0] >= low_y and q[0] <= high_y and q[1] >= low_z and q[1] <= high_z:
                if kept < _OWN_ROOM:
                    scratch[at + _OWN + kept * lanes + lane] = other
                kept = kept + 1
        first = first + lanes
    return column_of(at, found, kept, lane, lanes)
