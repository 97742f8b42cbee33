"""Boundary edges and the caps of their loops on the device, where few edges are unmatched.

The same as `sdm.topology.joining` and `sdm.topology.cap_triangles` find on the host.

For calls that must not wait: how many edges are unmatched, and how many bound the mesh, is guessed by the caller, and
flags tell whether that was right. Each step compares every edge with every other, which for a thousand takes a GPU
less time than a sort. Where loops meet, the k-th edge that ends at a vertex is followed by the k-th that begins there:
so they are closed loops all the same, perhaps through a vertex twice, and `cap_triangles` may cut them into others.
Which caps close a mesh is of no matter to a winding number.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import GPU_LANES, least_whole_of_lanes, sum_of_lanes, wait_for_block
from sdm.kernels.topology import boundary_flags
from sdm.kernels.topology.boundary_flags import ALL_EDGES, WRONG_EDGES, edges_in
from sdm.kernels.topology.edge_pairing import OUT_OF_RANGE, UNMATCHED
from sdm.kernels.topology.ends_at_one_place import join_ends, rows_of
from sdm.kernels.topology.many_edges import join_many_edges
from sdm.kernels.topology.many_loops import cap_many_loops

wp.set_module_options({"enable_backward": False})

# Where there may be more, to compare each with all takes longer than to sort them.
MOST_COMPARED = 1 << 13
_NONE = 0x7FFFFFFF
# Threads that number the loops, a block, of up to so many edges and of more; and numbers that each loads at once, and
# that each lane does which compares an edge with others.
BLOCK, FEW_LOOPED, LARGE_BLOCK, AT_ONCE, COMPARED = 128, 512, 512, 4, 8
Numbers = wp.types.vector(length=AT_ONCE, dtype=wp.int64)
Keys = wp.types.vector(length=COMPARED, dtype=wp.int64)
Others = wp.types.vector(length=COMPARED, dtype=wp.int32)


@wp.func
def key_of(same: wp.array(dtype=wp.int32), row: int):
    """The lower vertex of an edge, then the higher."""
    low = wp.min(same[2 * row], same[2 * row + 1])
    return (wp.int64(low) << wp.int64(32)) | wp.int64(wp.max(same[2 * row], same[2 * row + 1]))


@wp.kernel
def _add_up(
    begin: int,
    lanes: int,
    unmatched: wp.array2d(dtype=wp.int32),
    same: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.int32),
    balances: wp.array(dtype=wp.int32),
):
    """Net count of all edges between the same two vertices, noted at the first of them; zero at the others.

    And zero at rows that are not there, if more were guessed: what memory holds there would add up beyond all bounds.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    row = thread / lanes
    rows = rows_of(found, balances.shape[0])
    if row >= rows:
        if lane == 0:
            balances[row] = 0
        return
    key = key_of(same, row)
    first = row
    balance = int(0)
    other = lane
    while other < rows:
        keys = Keys()
        for k in range(COMPARED):
            keys[k] = key_of(same, wp.min(other + k * lanes, rows - 1))
        for k in range(COMPARED):
            at = other + k * lanes
            if at < rows and keys[k] == key:
                first = wp.min(first, at)
                up = same[2 * at + 1] - same[2 * at]
                balance = balance + wp.sign(up) * unmatched[at, 2]
        other = other + COMPARED * lanes
    # Small numbers, which floats hold exactly.
    balance = int(sum_of_lanes(float(balance)))
    first = least_whole_of_lanes(first)
    if same[2 * row] == same[2 * row + 1] or first != row:
        balance = int(0)
    if lane == 0:
        balances[row] = balance


@wp.kernel
def _write_edges(
    begin: int,
    lanes: int,
    same: wp.array(dtype=wp.int32),
    balances: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.int32),
    edges: wp.array2d(dtype=wp.int32),
    in_room: int,
    flags: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    row = thread / lanes
    if row == 0 and lane == 0:
        more = found[UNMATCHED] - balances.shape[0]
        flags[boundary_flags.WRONG_VERTEX] = flags[boundary_flags.WRONG_VERTEX] | found[OUT_OF_RANGE]
        flags[boundary_flags.ALL_UNMATCHED] = found[UNMATCHED]
        if in_room != 0:
            flags[boundary_flags.WRONG_UNMATCHED] = wp.max(more, 0)
        else:
            flags[boundary_flags.WRONG_UNMATCHED] = more
            fetch_add(flags, WRONG_EDGES, -edges.shape[0])
    rows = rows_of(found, balances.shape[0])
    if row >= rows:
        return
    key = key_of(same, row)
    before = int(0)
    other = lane
    while other < rows:
        keys = Keys()
        numbers = Others()
        for k in range(COMPARED):
            at = wp.min(other + k * lanes, rows - 1)
            keys[k] = key_of(same, at)
            numbers[k] = wp.abs(balances[at])
        for k in range(COMPARED):
            if other + k * lanes < rows and keys[k] < key:
                before = before + numbers[k]
        other = other + COMPARED * lanes
    at = int(sum_of_lanes(float(before)))
    if lane == 0:
        low = int(key >> wp.int64(32))
        high = int(key & wp.int64(0x7FFFFFFF))
        for i in range(at, wp.min(at + wp.abs(balances[row]), edges.shape[0])):
            edges[i, 0] = wp.where(balances[row] > 0, low, high)
            edges[i, 1] = wp.where(balances[row] > 0, high, low)
        number = wp.abs(balances[row])
        fetch_add(flags, ALL_EDGES, number)
        if in_room == 0:
            fetch_add(flags, WRONG_EDGES, number)


@wp.kernel
def _tell_room(begin: int, room: int, flags: wp.array(dtype=wp.int32)):
    """Tell, as `_follow` does, by how many edges there is too little room."""
    flags[WRONG_EDGES] = wp.max(flags[ALL_EDGES] - room, 0)


@wp.kernel
def _follow(
    begin: int,
    lanes: int,
    edges: wp.array2d(dtype=wp.int32),
    ahead: wp.array(dtype=wp.int64),
    ordered: wp.array(dtype=wp.int32),
    firsts: wp.array(dtype=wp.int32),
    in_room: int,
    flags: wp.array(dtype=wp.int32),
):
    """Of each edge its place in the order of first vertices, and that of the one that follows it, in one number.

    And the edges and the first vertices in that order.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    edge = thread / lanes
    count = edges_in(flags, edges.shape[0])
    if in_room != 0 and edge == 0 and lane == 0:
        flags[WRONG_EDGES] = wp.max(flags[ALL_EDGES] - edges.shape[0], 0)
    if edge >= count:
        return
    start = edges[edge, 0]
    end = edges[edge, 1]
    # Edges that end where this one does, and come before it; and those before it in the order.
    earlier = int(0)
    place = int(0)
    # Edges that begin before its end, and at it.
    below = int(0)
    meeting = int(0)
    other = lane
    while other < count:
        starts = Others()
        ends = Others()
        for k in range(COMPARED):
            at = wp.min(other + k * lanes, count - 1)
            starts[k] = edges[at, 0]
            ends[k] = edges[at, 1]
        for k in range(COMPARED):
            at = other + k * lanes
            if at < count:
                its = starts[k]
                if its < end:
                    below = below + 1
                elif its == end:
                    meeting = meeting + 1
                if ends[k] == end and at < edge:
                    earlier = earlier + 1
                if its < start or (its == start and at < edge):
                    place = place + 1
        other = other + COMPARED * lanes
    earlier = int(sum_of_lanes(float(earlier)))
    place = int(sum_of_lanes(float(place)))
    below = int(sum_of_lanes(float(below)))
    meeting = int(sum_of_lanes(float(meeting)))
    if lane == 0:
        following = below + earlier
        if earlier >= meeting:
            # The number of edges was guessed wrong.
            flags[boundary_flags.TANGLED] = 1
            following = place
        ordered[place] = edge
        firsts[place] = start
        ahead[edge] = (wp.int64(following) << wp.int64(32)) | wp.int64(place)


@wp.kernel
def _number_loops(
    begin: int,
    lanes: int,
    flags: wp.array(dtype=wp.int32),
    ordered: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=wp.int64),
    onward: wp.array(dtype=wp.int64),
    around: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
):
    """One block of threads: each edge's loop is known by its first edge in the order of first vertices, its place by
    the edges from it to that.

    Each number tells of the edges up to another one, and which is the first of those, or how many they are; in each
    step it is joined with the number there. A number is read and written as a whole, so that it does not matter who is
    first.
    """
    lane = (begin + wp.tid()) % lanes
    count = edges_in(flags, around.shape[0])
    # Each step joins twice as many as the one before, until they are more than there are.
    steps = int(0)
    while (count >> steps) > 0:
        steps = steps + 1
    low = wp.int64(0x7FFFFFFF)
    edge = lane
    while edge < count:
        # In place of the following one's place, that one.
        places = ahead[edge]
        following = wp.int64(ordered[int(places >> wp.int64(32))])
        ahead[edge] = (following << wp.int64(32)) | (places & low)
        onward[edge] = ahead[edge]
        edge = edge + lanes
    wait_for_block()
    for _step in range(steps):
        edge = lane
        while edge < count:
            mine = Numbers()
            theirs = Numbers()
            # All loads of a kind at once, as each takes long to arrive.
            for k in range(AT_ONCE):
                mine[k] = ahead[wp.min(edge + k * lanes, count - 1)]
            for k in range(AT_ONCE):
                theirs[k] = ahead[int(mine[k] >> wp.int64(32))]
            for k in range(AT_ONCE):
                if edge + k * lanes < count:
                    ahead[edge + k * lanes] = (theirs[k] & ~low) | wp.min(mine[k] & low, theirs[k] & low)
            edge = edge + AT_ONCE * lanes
        wait_for_block()
    edge = lane
    while edge < count:
        lowest = int(ahead[edge] & low)
        around[edge] = lowest
        # From there none are left. Until now this is the edge's own place in the order.
        if int(onward[edge] & low) == lowest:
            onward[edge] = wp.int64(edge) << wp.int64(32)
        else:
            onward[edge] = (onward[edge] & ~low) | wp.int64(1)
        edge = edge + lanes
    wait_for_block()
    for _step in range(steps):
        edge = lane
        while edge < count:
            mine = Numbers()
            theirs = Numbers()
            for k in range(AT_ONCE):
                mine[k] = onward[wp.min(edge + k * lanes, count - 1)]
            for k in range(AT_ONCE):
                theirs[k] = onward[int(mine[k] >> wp.int64(32))]
            for k in range(AT_ONCE):
                if edge + k * lanes < count:
                    onward[edge + k * lanes] = (theirs[k] & ~low) | ((mine[k] & low) + (theirs[k] & low))
            edge = edge + AT_ONCE * lanes
        wait_for_block()
    edge = lane
    while edge < count:
        left[edge] = int(onward[edge] & low)
        edge = edge + lanes


@wp.kernel
def _write_caps(
    begin: int,
    lanes: int,
    edges: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    around: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    firsts: wp.array(dtype=wp.int32),
    caps: wp.array2d(dtype=wp.int32),
):
    """The cap that cuts off each edge's first vertex, see `sdm.topology.cap_triangles`."""
    thread = begin + wp.tid()
    lane = thread % lanes
    edge = thread / lanes
    count = edges_in(flags, edges.shape[0])
    if edge >= count:
        return
    loop = around[edge]
    place = left[edge]
    step = place & (-place)
    before = int(_NONE)
    after = int(_NONE)
    other = lane
    while other < count:
        loops = Others()
        places = Others()
        for k in range(COMPARED):
            at = wp.min(other + k * lanes, count - 1)
            loops[k] = around[at]
            places[k] = left[at]
        for k in range(COMPARED):
            # Who comes twice does no harm.
            if loops[k] == loop:
                if places[k] == place - step:
                    before = edges[wp.min(other + k * lanes, count - 1), 0]
                if places[k] == place + step:
                    after = edges[wp.min(other + k * lanes, count - 1), 0]
        other = other + COMPARED * lanes
    before = least_whole_of_lanes(before)
    after = least_whole_of_lanes(after)
    if lane == 0:
        first = firsts[loop]
        caps[edge, 0] = wp.where(before == _NONE, first, before)
        caps[edge, 1] = edges[edge, 0]
        caps[edge, 2] = wp.where(after == _NONE, first, after)


def join_edges(
    unmatched: wp.array,
    found: wp.array,
    vertices: wp.array,
    edges: wp.array,
    caps: wp.array | None,
    flags: wp.array,
    empty: Callable[[int, Any], wp.array],
    in_room: bool = False,
    written: Callable[[], None] | None = None,
) -> None:
    """Boundary edges and caps from what `sdm.kernels.topology.edge_pairing` found.

    Args:
        unmatched: (N,3) int32, as many rows of the unmatched edges as are guessed to be, or have room.
        found: (2) int32, the flags of `edge_pairing.pair_edges`.
        vertices: (meshes, V) vec3.
        edges: (E,2) int32, zero; filled with what `sdm.topology.joining.join_on_host` returns. E is a guess.
        caps: (E,3) int32, filled with what `sdm.topology.cap_triangles.cap_triangles` returns, where no loops meet;
            None: nobody needs any, of edges in room.
        flags: (NUMBERS) int32, zero; afterwards the first FLAGS are still zero if all guesses were right, else the rest
            has no meaning, but no index is out of range.
        empty: Allocates workspace: `empty(length, dtype)`.
        in_room: N and E are not guesses, but room for any number: rows behind those that there are stay as they were.
        written: Called once the kernels are queued that write `edges` and tell how many there are.
    """
    device, rows, count = vertices.device, unmatched.shape[0], edges.shape[0]
    if max(rows, count) > MOST_COMPARED:
        join_many_edges(unmatched, found, vertices, edges, flags, empty, in_room)
        if written is not None:
            written()
        if caps is not None:
            cap_many_loops(edges, caps, flags, vertices.shape[1], empty)
        return
    lanes = GPU_LANES if device.is_cuda else 1
    same, balances = empty(2 * rows, wp.int32), empty(rows, wp.int32)
    ahead, onward = empty(count, wp.int64), empty(count, wp.int64)
    around, left, firsts, ordered = (empty(count, wp.int32) for _ in range(4))
    join_ends(unmatched, vertices, same, found)
    launch(_add_up, rows * lanes, [lanes, unmatched, same, found, balances], device)
    launch(_write_edges, rows * lanes, [lanes, same, balances, found, edges, int(in_room), flags], device)
    if written is not None:
        written()
    if caps is None:
        launch(_tell_room, 1, [count, flags], device)
        return
    launch(_follow, count * lanes, [lanes, edges, ahead, ordered, firsts, int(in_room), flags], device)
    block = (BLOCK if count <= FEW_LOOPED else LARGE_BLOCK) if device.is_cuda else 1
    launch(_number_loops, block, [block, flags, ordered, ahead, onward, around, left], device, block_dim=block)
    launch(_write_caps, count * lanes, [lanes, edges, flags, around, left, firsts, caps], device)
