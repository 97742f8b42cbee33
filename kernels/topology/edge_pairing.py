"""Pairing of a mesh's faces at their edges, and unmatched edges: one sort of all edges.

Edge k of face f has the number 3 f + k. It leads from the face's corner k to the next.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.launch import LIGHT_SHARE, launch
from sdm.kernels.launches.arrays import SHORT_BITS, array_at, short_keys
from sdm.kernels.primitives.atomics import fetch_add, keep_least

wp.set_module_options({"enable_backward": False})

# Places of the flags about a mesh.
OUT_OF_RANGE, UNMATCHED, FLAGS = 0, 1, 2


def bits_for(vertices: int) -> int:
    """Bits of a vertex index in a key: the key of an edge is the lower of its ends, then the higher."""
    return max(1, (vertices - 1).bit_length())


@wp.func
def edge_key(
    faces: wp.array2d(dtype=wp.int32),
    vertices: int,
    bits: int,
    first: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    clamp: int,
    within: wp.array2d(dtype=wp.int32),
    edge: int,
):
    """The key of an edge; what else is found on the way is written down."""
    face = edge / 3
    start = faces[face, edge % 3]
    if clamp != 0:
        within[face, edge % 3] = wp.clamp(start, 0, vertices - 1)
    end = faces[face, (edge + 1) % 3]
    key = wp.int64(0)
    if start < 0 or start >= vertices:
        flags[OUT_OF_RANGE] = 1
    else:
        keep_least(first, start, face - faces.shape[0])
        key = (wp.int64(wp.min(start, end)) << wp.int64(bits)) | wp.int64(wp.max(start, end))
    return key


@wp.kernel
def _make_keys(
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    vertices: int,
    bits: int,
    keys: wp.array(dtype=wp.int64),
    edges: wp.array(dtype=wp.int32),
    first: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    clamp: int,
    within: wp.array2d(dtype=wp.int32),
):
    edge = begin + wp.tid()
    keys[edge] = edge_key(faces, vertices, bits, first, flags, clamp, within, edge)
    edges[edge] = edge


@wp.kernel
def _make_short_keys(
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    vertices: int,
    bits: int,
    keys: wp.array(dtype=wp.int32),
    edges: wp.array(dtype=wp.int32),
    first: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    clamp: int,
    within: wp.array2d(dtype=wp.int32),
):
    edge = begin + wp.tid()
    keys[edge] = wp.int32(edge_key(faces, vertices, bits, first, flags, clamp, within, edge))
    edges[edge] = edge


@wp.func
def direction(faces: wp.array2d(dtype=wp.int32), edge: int):
    """1 if an edge leads from the lower vertex to the higher, -1 if back, 0 if nowhere."""
    start = faces[edge / 3, edge % 3]
    end = faces[edge / 3, (edge + 1) % 3]
    return wp.where(start < end, 1, wp.where(end < start, -1, 0))


@wp.func
def pair_group(
    i: int,
    faces: wp.array2d(dtype=wp.int32),
    keys: wp.array(dtype=Any),
    edges: wp.array(dtype=wp.int32),
    unmatched: wp.array2d(dtype=wp.int32),
    owned: wp.array(dtype=wp.int32),
    neighbours: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
):
    """Pair the edges with the same ends whose first is the i-th in order; nothing if that is none."""
    total = 3 * faces.shape[0]
    key = keys[i]
    if i > 0:
        if keys[i - 1] == key:
            return
    lead = edges[i]
    somewhere = direction(faces, lead) != 0
    balance = int(0)
    edge = lead
    at = i
    more = bool(True)
    while more:
        balance = balance + direction(faces, edge)
        at = at + 1
        more = False
        if at < total:
            more = keys[at] == key
        # The next face at the same edge; after the last comes the first.
        following = lead
        if more:
            following = edges[at]
        neighbours[edge / 3, edge % 3] = wp.where(somewhere and following != edge, following, -1)
        owned[edge] = wp.where(somewhere and edge == lead, 1, 0)
        edge = following
    if balance != 0:
        start = faces[lead / 3, lead % 3]
        end = faces[lead / 3, (lead + 1) % 3]
        row = fetch_add(flags, UNMATCHED, 1)
        unmatched[row, 0] = wp.min(start, end)
        unmatched[row, 1] = wp.max(start, end)
        unmatched[row, 2] = balance


@wp.kernel
def _pair(
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    keys: wp.array(dtype=wp.int64),
    edges: wp.array(dtype=wp.int32),
    unmatched: wp.array2d(dtype=wp.int32),
    owned: wp.array(dtype=wp.int32),
    neighbours: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
):
    """One thread for each group of edges with the same ends."""
    pair_group(begin + wp.tid(), faces, keys, edges, unmatched, owned, neighbours, flags)


@wp.kernel
def _pair_short(
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    keys: wp.array(dtype=wp.int32),
    edges: wp.array(dtype=wp.int32),
    unmatched: wp.array2d(dtype=wp.int32),
    owned: wp.array(dtype=wp.int32),
    neighbours: wp.array2d(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
):
    pair_group(begin + wp.tid(), faces, keys, edges, unmatched, owned, neighbours, flags)


@wp.kernel
def _own(
    begin: int,
    faces: wp.array2d(dtype=wp.int32),
    owned: wp.array(dtype=wp.int32),
    first: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    neighbours: wp.array2d(dtype=wp.int32),
):
    if flags[OUT_OF_RANGE] != 0:
        return
    face = begin + wp.tid()
    bits = int(0)
    for k in range(3):
        bits = bits | (owned[3 * face + k] << (k + 3))
        if first[faces[face, k]] == face - faces.shape[0]:
            bits = bits | (1 << k)
    neighbours[face, 3] = bits


def pair_edges(
    faces: wp.array,
    first: wp.array,
    flags: wp.array,
    unmatched: wp.array,
    neighbours: wp.array,
    empty: Callable[[int, Any], wp.array],
    within: wp.array | None = None,
) -> None:
    """Pair the faces' edges for `sdm.topology.boundary_edges`, on their device.

    Args:
        faces: (F,3) int32.
        first: (V) int32, zero; afterwards F less than the first face at each vertex.
        flags: (FLAGS) int32, zero; afterwards 1 if there is a vertex out of range (then all else has no meaning),
            and the number of unmatched edges.
        unmatched: (3 * F, 3) int32; afterwards the first rows are the unmatched edges, in any order: the lower vertex,
            the higher, and how many more of the edges between them lead up than back.
        neighbours: (F,4) int32, filled as `sdm.topology.boundary_edges.neighbours` says.
        empty: Allocates workspace: `empty(length, dtype)`.
        within: (F,3) int32, filled with the faces, whose indices out of range are brought into it; None: nobody asks.
    """
    count, vertices, device = faces.shape[0], first.shape[0], faces.device
    total, bits = 3 * count, bits_for(vertices)
    keys, edges, owned = empty(2 * total, wp.int64), empty(2 * total, wp.int32), empty(total, wp.int32)
    clamped = [0, faces] if within is None else [1, within]
    make, pair = _make_keys, _pair
    if short_keys(total, 2 * bits) if device.is_cuda else 2 * bits <= SHORT_BITS:
        make, pair = _make_short_keys, _pair_short
        keys = array_at(keys.ptr, (2 * total,), wp.int32, device.alias)
    inputs = [faces, vertices, bits, keys, edges, first, flags, *clamped]
    launch(make, total, inputs, device, smallest=LIGHT_SHARE)
    wp.utils.radix_sort_pairs(keys, edges, total, 0, 2 * bits)
    launch(pair, total, [faces, keys, edges, unmatched, owned, neighbours, flags], device, smallest=LIGHT_SHARE)
    launch(_own, count, [faces, owned, first, flags, neighbours], device, smallest=LIGHT_SHARE)


@wp.kernel
def _gather_ends(
    begin: int,
    unmatched: wp.array2d(dtype=wp.int32),
    vertices: wp.array2d(dtype=wp.vec3),
    rows: wp.array2d(dtype=wp.int32),
    places: wp.array2d(dtype=wp.vec3),
):
    i = begin + wp.tid()
    edge = i / 2
    for k in range(3):
        rows[edge, k] = unmatched[edge, k]
    for mesh in range(vertices.shape[0]):
        places[i, mesh] = vertices[mesh, unmatched[edge, i % 2]]


def gather_ends(unmatched: wp.array, vertices: wp.array, rows: wp.array, places: wp.array) -> None:
    """Copy the unmatched edges (N,3) to `rows`, and where their ends are to `places`.

    `vertices` is (meshes, V) vec3, `places` (2 * N, meshes) vec3, the lower vertex of each edge first.
    """
    launch(_gather_ends, places.shape[0], [unmatched, vertices, rows, places], vertices.device)
