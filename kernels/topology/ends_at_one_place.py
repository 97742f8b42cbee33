"""Ends of unmatched edges that are at one place: vertices at equal positions count as the first of them."""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import GPU_LANES, least_whole_of_lanes
from sdm.kernels.topology.edge_pairing import UNMATCHED

wp.set_module_options({"enable_backward": False})

# Numbers that each lane loads at a time, as each takes long to arrive.
AT_ONCE = 8

Ends = wp.types.vector(length=AT_ONCE, dtype=wp.int32)
Places = wp.types.vector(length=AT_ONCE, dtype=wp.float32)


@wp.func
def rows_of(found: wp.array(dtype=wp.int32), room: int):
    """Unmatched edges, as far as they are guessed or have room; none if there is no room for all."""
    rows = found[UNMATCHED]
    return wp.where(rows <= room, rows, 0)


@wp.func
def end_of(unmatched: wp.array2d(dtype=wp.int32), end: int, vertices: int):
    """The vertex at an end of an unmatched edge; one that is there, if the rows are not."""
    return wp.clamp(unmatched[end / 2, end % 2], 0, vertices - 1)


@wp.func
def first_of_ends(
    unmatched: wp.array2d(dtype=wp.int32),
    vertices: wp.array2d(dtype=wp.vec3),
    ends: int,
    end: int,
    lane: int,
    lanes: int,
):
    """The lowest vertex among those of all ends that are where one is."""
    count = vertices.shape[1]
    mine = end_of(unmatched, end, count)
    here = vertices[0, mine]
    least = mine
    other = lane
    while other < ends:
        theirs = Ends()
        x = Places()
        y = Places()
        z = Places()
        for k in range(AT_ONCE):
            # Who comes twice does no harm.
            theirs[k] = end_of(unmatched, wp.min(other + k * lanes, ends - 1), count)
        for k in range(AT_ONCE):
            there = vertices[0, theirs[k]]
            x[k] = there[0]
            y[k] = there[1]
            z[k] = there[2]
        for k in range(AT_ONCE):
            if theirs[k] < least and here == wp.vec3(x[k], y[k], z[k]):
                equal = bool(True)
                for mesh in range(1, vertices.shape[0]):
                    equal = equal and vertices[mesh, mine] == vertices[mesh, theirs[k]]
                if equal:
                    least = theirs[k]
        other = other + AT_ONCE * lanes
    return least_whole_of_lanes(least)


@wp.kernel
def _join_ends(
    begin: int,
    lanes: int,
    unmatched: wp.array2d(dtype=wp.int32),
    vertices: wp.array2d(dtype=wp.vec3),
    found: wp.array(dtype=wp.int32),
    same: wp.array(dtype=wp.int32),
):
    """For each end the lowest vertex among all ends at its position."""
    thread = begin + wp.tid()
    lane = thread % lanes
    end = thread / lanes
    ends = same.shape[0]
    if found.shape[0] > 0:
        ends = 2 * rows_of(found, same.shape[0] / 2)
    if end >= ends:
        return
    least = first_of_ends(unmatched, vertices, ends, end, lane, lanes)
    if lane == 0:
        same[end] = least


@wp.kernel
def _compare_ends(
    begin: int,
    lanes: int,
    unmatched: wp.array2d(dtype=wp.int32),
    vertices: wp.array2d(dtype=wp.vec3),
    same: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
):
    """Set a flag if `_join_ends` would find something else."""
    thread = begin + wp.tid()
    lane = thread % lanes
    end = thread / lanes
    least = first_of_ends(unmatched, vertices, same.shape[0], end, lane, lanes)
    if lane == 0 and least != same[end]:
        flags[0] = 1


def join_ends(unmatched: wp.array, vertices: wp.array, same: wp.array, found: wp.array | None = None) -> None:
    """Fill `same` (2 * N) int32: for each end of the unmatched edges (N,3) the lowest vertex of all ends at its place.

    `vertices` is (meshes, V) vec3. What bounds the mesh depends on positions by this alone. Where N is room or a guess,
    `found` (2) int32 tells how many there are, see `edge_pairing.pair_edges`.
    """
    lanes = GPU_LANES if vertices.device.is_cuda else 1
    counts = same[:0] if found is None else found
    launch(_join_ends, same.shape[0] * lanes, [lanes, unmatched, vertices, counts, same], vertices.device)


def compare_ends(unmatched: wp.array, vertices: wp.array, same: wp.array, flags: wp.array) -> None:
    """Set `flags` (1) to 1 if `join_ends` would fill `same` otherwise."""
    lanes = GPU_LANES if vertices.device.is_cuda else 1
    launch(_compare_ends, same.shape[0] * lanes, [lanes, unmatched, vertices, same, flags], vertices.device)
