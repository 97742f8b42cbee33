"""A mesh's arrays, taken from wherever they are, and faces of no area behind its own.

So meshes with other numbers of faces, in other places of memory, look alike to a recorded call. What it finds for the
caller goes to an address, too.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import lessen
from sdm.kernels.primitives.lanes import GPU_LANES, least_of_lanes

wp.set_module_options({"enable_backward": False})

# Entries of the counts: faces and vertices of the mesh.
FACES, VERTICES, COUNTS = 0, 1, 2
# Entries of the addresses: of the mesh's vertices and faces, of its map, of how many voxels are ambiguous, and of what
# its faces say.
VERTICES_AT, FACES_AT, VALUES_AT, AMBIGUOUS_AT, TOLD_AT, ADDRESSES = 0, 1, 2, 3, 4, 5


@wp.func_native(snippet="return reinterpret_cast<const int*>(address)[index];")
def _int_at(address: wp.int64, index: int) -> int: ...


@wp.func_native(snippet="return reinterpret_cast<const wp::int64*>(address)[index];")
def _long_at(address: wp.int64, index: int) -> wp.int64: ...


@wp.func_native(snippet="return reinterpret_cast<const wp::vec3*>(address)[index];")
def _vector_at(address: wp.int64, index: int) -> wp.vec3: ...


@wp.func_native(snippet="reinterpret_cast<int*>(address)[index] = value;")
def _put_int(address: wp.int64, index: int, value: int): ...


@wp.kernel
def _copy_table(
    begin: int,
    host: wp.int64,
    table: wp.array(dtype=wp.int64),
    zeros: wp.array(dtype=wp.int32),
    bounds: wp.array(dtype=wp.float32),
):
    i = begin + wp.tid()
    if i < table.shape[0]:
        table[i] = _long_at(host, i)
    if i < zeros.shape[0]:
        zeros[i] = 0
    if i < bounds.shape[0]:
        bounds[i] = float(wp.inf)


@wp.func
def _bring_down(bounds: wp.array(dtype=wp.float32), mesh: int, low: wp.vec3, lowest: wp.vec3, lane: int):
    """A mesh's lowest coordinates, and its highest ones with the other sign, by those of all lanes."""
    for axis in range(3):
        least = least_of_lanes(low[axis])
        other = least_of_lanes(lowest[axis])
        # All who come here write to the same few places, one after the other: those without a face need not.
        if lane == 0 and least < wp.inf:
            lessen(bounds, 6 * mesh + axis, least)
            lessen(bounds, 6 * mesh + 3 + axis, other)


@wp.kernel
def _take_in(
    begin: int,
    lanes: int,
    addresses: wp.array(dtype=wp.int64),
    counts: wp.array(dtype=wp.int32),
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    wrong: wp.array(dtype=wp.int32),
    bounds: wp.array(dtype=wp.float32),
):
    i = begin + wp.tid()
    count = counts[FACES]
    points = counts[VERTICES]
    if i < points:
        vertices[i] = _vector_at(addresses[VERTICES_AT], i)
    # Each at a vertex of its own, as far as there are enough, so that none has many.
    filler = i % points
    given_at = addresses[FACES_AT]
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    lowest = low
    if i < faces.shape[0]:
        for k in range(3):
            index = filler
            if i < count:
                given = _int_at(given_at, 3 * i + k)
                index = wp.clamp(given, 0, points - 1)
                if index != given:
                    wrong[0] = 1
                v = _vector_at(addresses[VERTICES_AT], index)
                low = wp.min(low, v)
                lowest = wp.min(lowest, -v)
            faces[i, k] = index
    _bring_down(bounds, 0, low, lowest, i % lanes)
    # The second mesh is the first face behind.
    if i == count:
        v = _vector_at(addresses[VERTICES_AT], filler)
        for axis in range(3):
            bounds[6 + axis] = v[axis]
            bounds[9 + axis] = -v[axis]


def copy_table(host: int, table: wp.array, zeros: wp.array, bounds: wp.array) -> None:
    """Copy a table, and prepare what comes after.

    Args:
        host: Where the table is, in memory that the device reads: pinned, for a GPU. A launch of its own reads it, as
            it takes each group of lanes some microseconds.
        table: (T) int64, filled.
        zeros: (Z) int32, filled with zeros.
        bounds: (6 * meshes) float32, as `sdm.kernels.bvh.build.reset_bounds` leaves them.
    """
    count = max(table.shape[0], zeros.shape[0], bounds.shape[0])
    launch(_copy_table, count, [host, table, zeros, bounds], table.device)


def take_in(
    addresses: wp.array, counts: wp.array, vertices: wp.array, faces: wp.array, wrong: wp.array, bounds: wp.array
) -> None:
    """Copy the vertices and faces of a mesh, and put faces of no area behind these.

    Args:
        addresses: (ADDRESSES) int64; those of vertices (V,3) float32 and faces (F,3) int32 are read.
        counts: (COUNTS) int32, V and F, at least one each.
        vertices: (room) vec3; the first V are filled.
        faces: (room,3) int32, filled: indices out of range are brought into it.
        wrong: (1) int32, set to 1 if there were any.
        bounds: (12) float32, as `copy_table` leaves them: lowered as by `sdm.kernels.bvh.build.reduce_bounds`, those of
            the mesh, and of the first face behind its own as a mesh of one.
    """
    lanes = GPU_LANES if faces.device.is_cuda else 1
    # Whole groups, as all lanes of one compare what they have.
    count = -(-max(vertices.shape[0], faces.shape[0]) // lanes) * lanes
    launch(_take_in, count, [lanes, addresses, counts, vertices, faces, wrong, bounds], faces.device)


@wp.kernel
def _tell(
    begin: int,
    counts: wp.array(dtype=wp.int32),
    addresses: wp.array(dtype=wp.int64),
    neighbours: wp.array(dtype=wp.int32),
    unmatched: wp.array(dtype=wp.int32),
    boundary: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    host: wp.int64,
):
    i = begin + wp.tid()
    if i < flags.shape[0]:
        _put_int(host, i, flags[i])
    own = 4 * counts[FACES]
    number = int(0)
    place = i
    if i < neighbours.shape[0]:
        if i >= own:
            return
        number = neighbours[i]
    else:
        behind = i - neighbours.shape[0]
        place = own + behind
        if behind < unmatched.shape[0]:
            number = unmatched[behind]
        else:
            number = boundary[behind - unmatched.shape[0]]
    _put_int(addresses[TOLD_AT], place, number)


def tell(
    counts: wp.array,
    addresses: wp.array,
    neighbours: wp.array,
    unmatched: wp.array,
    boundary: wp.array,
    flags: wp.array,
    host: int,
) -> None:
    """Write what a mesh's faces say to the address TOLD_AT: its neighbours, unmatched edges, and boundary, in a row.

    Args:
        counts: (COUNTS) int32, as for `take_in`.
        addresses: (ADDRESSES) int64.
        neighbours: (4 * room) int32, of which those of the F own faces are written.
        unmatched: (U) int32, of any length.
        boundary: (B) int32, of any length; so 4 F + U + B numbers are written.
        flags: (N) int32, at most 4 * room.
        host: Where these are written: memory that the device writes to, pinned for a GPU.
    """
    count = neighbours.shape[0] + unmatched.shape[0] + boundary.shape[0]
    launch(_tell, count, [counts, addresses, neighbours, unmatched, boundary, flags, host], neighbours.device)


@wp.kernel
def _tell_ambiguous(begin: int, addresses: wp.array(dtype=wp.int64), ambiguous: wp.array(dtype=wp.int32)):
    _put_int(addresses[AMBIGUOUS_AT], 0, ambiguous[0])


def tell_ambiguous(addresses: wp.array, ambiguous: wp.array) -> None:
    """Write the first of `ambiguous` int32 to the address AMBIGUOUS_AT."""
    launch(_tell_ambiguous, 1, [addresses, ambiguous], ambiguous.device)
