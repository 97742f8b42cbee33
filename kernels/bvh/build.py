"""Build of the bounding volume hierarchy: a sort, and boxes level by level.

Triangles are sorted along a Hilbert curve about their mesh's box, the numbers of meshes above the curve's codes in the
keys. So the whole build is that sort and a few short launches, is the same every time, and needs no memory but the
arrays that it is given. Meshes that differ are built at once too: `tree_of` says where each begins.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.node_boxes import bound_nodes
from sdm.kernels.bvh.rank_sort import RankSort, bucket_of, counts_behind, is_ranked
from sdm.kernels.bvh.tree import (
    DIAGONAL,
    FRAME_SIZE,
    LATTICE,
    LATTICE_STEPS,
    LOW_X,
    REACH,
    SCALE,
    UNSCALE,
    Tree,
    mesh_of_slot,
    rows_before,
    slots_of,
    to_lattice,
    tree_of,
    write_corners,
)
from sdm.kernels.geometry.hilbert import COARSE_BITS, FEW, FINE_BITS, curve_bits, curve_code
from sdm.kernels.geometry.triangle_distance import unit_normal
from sdm.kernels.launch import CURVE_SHARE, LIGHT_SHARE, launch
from sdm.kernels.launches.arrays import SHORT_BITS, array_at, short_keys
from sdm.kernels.primitives.atomics import fetch_add, lessen
from sdm.kernels.primitives.coalesced_stores import begin_record, end_record, pairs_at, put_pair
from sdm.kernels.primitives.lanes import GPU_LANES, least_of_lanes
from sdm.kernels.primitives.vector_loads import write4

wp.set_module_options({"enable_backward": False})

# Triangles that each lane looks at for the mesh's bounds, of few and of many.
FEW_RUN, RUN = 2, 8
FEW_TRIANGLES = 1 << 15
LARGEST_SCALE = wp.float64(2.0**126)
# Bytes of a triangle's corners on the lattice.
_LATTICE_SIZE = 24


@wp.kernel
def _reset_bounds(begin: int, bounds: wp.array(dtype=wp.float32), zeros: wp.array(dtype=wp.int32)):
    thread = begin + wp.tid()
    if thread < bounds.shape[0]:
        bounds[thread] = float(wp.inf)
    if thread < zeros.shape[0]:
        zeros[thread] = 0


@wp.kernel
def _reduce_bounds(
    begin: int,
    lanes: int,
    tree: Tree,
    vertices: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    run: int,
    bounds: wp.array(dtype=wp.float32),
):
    """Bring down each mesh's lowest coordinates, and its highest ones with the other sign: `run` faces a lane."""
    thread = begin + wp.tid()
    lane = thread % lanes
    runs = (tree.count + run * lanes - 1) / (run * lanes)
    mesh = thread / lanes / runs
    one = tree_of(tree, mesh)
    rows = rows_before(tree, mesh)
    face = (thread / lanes % runs) * run * lanes + lane
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    lowest = low
    for _step in range(run):
        if face < one.count:
            for corner in range(3):
                v = vertices[mesh, faces[rows + face, corner]]
                low = wp.min(low, v)
                lowest = wp.min(lowest, -v)
        face = face + lanes
    for axis in range(3):
        least = least_of_lanes(low[axis])
        other = least_of_lanes(lowest[axis])
        if lane == 0 and least < wp.inf:
            lessen(bounds, 6 * mesh + axis, least)
            lessen(bounds, 6 * mesh + 3 + axis, other)


@wp.kernel
def _make_frames(begin: int, bounds: wp.array(dtype=wp.float32), frame: wp.array(dtype=wp.float64)):
    mesh = begin + wp.tid()
    largest = wp.float64(0.0)
    for i in range(6):
        if i >= 3:
            bounds[6 * mesh + i] = -bounds[6 * mesh + i]
        largest = wp.max(largest, wp.float64(wp.abs(bounds[6 * mesh + i])))
    # A power of two that brings the largest coordinate into (1/2, 1]; multiplying by it rounds nothing.
    scale = wp.float64(1.0)
    half = wp.float64(0.5)
    two = wp.float64(2.0)
    while largest * scale > wp.float64(1.0):
        scale = scale * half
    # It stays a float32 even for the smallest numbers.
    while largest * scale <= half and scale < LARGEST_SCALE:
        scale = scale * two
    base = mesh * FRAME_SIZE
    frame[base + SCALE] = scale
    frame[base + UNSCALE] = wp.float64(1.0) / scale
    extent = wp.float64(0.0)
    diagonal2 = wp.float64(0.0)
    for axis in range(3):
        low = wp.float64(bounds[6 * mesh + axis]) * scale
        high = wp.float64(bounds[6 * mesh + 3 + axis]) * scale
        frame[base + LOW_X + axis] = low
        if axis > 0:
            extent = wp.max(extent, high - low)
        diagonal2 = diagonal2 + (high - low) * (high - low)
    frame[base + DIAGONAL] = wp.sqrt(diagonal2)
    frame[base + REACH] = largest * scale
    frame[base + LATTICE] = wp.where(extent > wp.float64(0.0), LATTICE_STEPS / extent, wp.float64(0.0))


@wp.func
def sorting_key(
    tree: Tree,
    vertices: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    bounds: wp.array(dtype=wp.float32),
    bits: int,
    numbered: int,
    i: int,
):
    """The key of a slot's face, and its number in its mesh."""
    mesh = mesh_of_slot(tree, i)
    one = tree_of(tree, mesh)
    f = i - slots_of(one, mesh)
    row = rows_before(tree, mesh) + f
    scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
    a = scale * vertices[mesh, faces[row, 0]]
    b = scale * vertices[mesh, faces[row, 1]]
    c = scale * vertices[mesh, faces[row, 2]]
    low = scale * wp.vec3(bounds[6 * mesh], bounds[6 * mesh + 1], bounds[6 * mesh + 2])
    high = scale * wp.vec3(bounds[6 * mesh + 3], bounds[6 * mesh + 4], bounds[6 * mesh + 5])
    # The middle of the triangle's box: for long triangles better than the mean of the corners.
    middle = 0.5 * (wp.min(a, wp.min(b, c)) + wp.max(a, wp.max(b, c)))
    key = curve_code(middle, low, high, curve_bits(one.count))
    if numbered != 0:
        key = (wp.int64(mesh) << wp.int64(3 * bits)) | key
    elif mesh > 0:
        # No key is above this one, and the first mesh's are before those that are equal.
        key = (wp.int64(1) << wp.int64(3 * bits)) - wp.int64(1)
    return key, f


@wp.kernel
def _make_keys(
    begin: int,
    tree: Tree,
    vertices: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    bounds: wp.array(dtype=wp.float32),
    bits: int,
    numbered: int,
    keys: wp.array(dtype=wp.int64),
    slots: wp.array(dtype=wp.int32),
):
    i = begin + wp.tid()
    key, f = sorting_key(tree, vertices, faces, bounds, bits, numbered, i)
    keys[i] = key
    slots[i] = f


@wp.kernel
def _make_short_keys(
    begin: int,
    tree: Tree,
    vertices: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    bounds: wp.array(dtype=wp.float32),
    bits: int,
    numbered: int,
    keys: wp.array(dtype=wp.int32),
    slots: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
):
    i = begin + wp.tid()
    key, f = sorting_key(tree, vertices, faces, bounds, bits, numbered, i)
    keys[i] = wp.int32(key)
    slots[i] = f
    # See `rank_sort`.
    if counts.shape[0] > 0 and i < tree_of(tree, 0).count:
        fetch_add(counts, bucket_of(key, 3 * bits), 1)


@wp.kernel
def _gather_triangles(
    begin: int,
    vertices: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    sorted_faces: wp.array(dtype=wp.int32),
    tree: Tree,
    normals: wp.array(dtype=wp.float32),
):
    i = begin + wp.tid()
    mesh = mesh_of_slot(tree, i)
    one = tree_of(tree, mesh)
    f = sorted_faces[i]
    tree.face[i] = f
    row = rows_before(tree, mesh) + f
    scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
    a = scale * vertices[mesh, faces[row, 0]]
    b = scale * vertices[mesh, faces[row, 1]]
    c = scale * vertices[mesh, faces[row, 2]]
    lattice = pairs_at(tree.lattice)
    record = begin_record(lattice, _LATTICE_SIZE, i)
    put_pair(record, 0, to_lattice(tree, mesh, wp.float64(a[1]), wp.float64(a[2])))
    put_pair(record, 1, to_lattice(tree, mesh, wp.float64(b[1]), wp.float64(b[2])))
    put_pair(record, 2, to_lattice(tree, mesh, wp.float64(c[1]), wp.float64(c[2])))
    end_record(lattice, record, _LATTICE_SIZE, i, tree.face.shape[0])
    n = wp.vec3(unit_normal(wp.vec3d(a), wp.vec3d(b), wp.vec3d(c)))
    write_corners(tree, i, a, b, c, n)
    write4(normals, slots_of(one, mesh) + f, n[0], n[1], n[2], 0.0)


def reset_bounds(bounds: wp.array) -> None:
    """Make `bounds` (6 * meshes,) float32 ready for `reduce_bounds`."""
    device: Any = bounds.device
    launch(_reset_bounds, bounds.shape[0], [bounds, array_at(0, (0,), wp.int32, device.alias)], device)


def reduce_bounds(tree: Tree, vertices: wp.array, faces: wp.array, bounds: wp.array) -> None:
    """Lower `bounds` (6 * meshes,) float32 to each mesh's lowest coordinates, and its highest ones with a minus.

    The rest as for `build_tree`.
    """
    device: Any = vertices.device
    meshes, lanes = vertices.shape[0], GPU_LANES if device.is_cuda else 1
    run = FEW_RUN if tree.count <= FEW_TRIANGLES else RUN
    groups = meshes * -(-tree.count // (run * lanes))
    launch(_reduce_bounds, groups * lanes, [lanes, tree, vertices, faces, run, bounds], device, smallest=LIGHT_SHARE)


def build_tree(
    tree: Tree,
    vertices: wp.array,
    faces: wp.array,
    bounds: wp.array,
    keys: wp.array,
    slots: wp.array,
    normals: wp.array,
    gathered: Callable[[], None] | None = None,
    *,
    fillers: bool = False,
    is_bounded: bool = False,
    counts: wp.array | None = None,
) -> None:
    """Fill `tree` (allocated as `sizes` says, `count` and `depth` set) on the arrays' device.

    Args:
        tree: What to fill.
        vertices: (meshes, V) vec3; of meshes that differ each row is all of their vertices, over the same memory.
        faces: (F, 3) int32, shared by the meshes; of meshes that differ one after the other, by all vertices.
        bounds: (6 * meshes) float32: afterwards each mesh's lowest and highest coordinates.
        keys: (2 * slots) int64, workspace.
        slots: (2 * slots) int32, workspace.
        normals: (4 * slots) float32: afterwards each face's unit normal, in the order of the faces, and 0.
        gathered: Called once all is queued but the nodes' boxes.
        fillers: All meshes but the first only fill room, so that the order of their triangles does not matter.
        is_bounded: `bounds` are as `reduce_bounds` leaves them.
        counts: Zeros for `RankSort`, if there are any.
    """
    meshes, total = vertices.shape[0], tree.face.shape[0]
    # The host's way to the first launch is short (`sdm.bench.dense.host_calls`).
    if not is_bounded:
        if counts is None and _is_ranked(tree, bounds.device, meshes, fillers):
            # A launch of its own for so few zeros would be waited for as long as one that works.
            counts = counts_behind(keys, total)
        zeros = slots[:0] if counts is None else counts
        launch(_reset_bounds, max(6 * meshes, zeros.shape[0]), [bounds, zeros], vertices.device)
        reduce_bounds(tree, vertices, faces, bounds)
    launch(_make_frames, meshes, [bounds, tree.frame], vertices.device)
    build_in_frame(tree, vertices, faces, bounds, keys, slots, normals, gathered, fillers=fillers, counts=counts)


def _bits(tree: Tree, meshes: int, fillers: bool) -> tuple[int, int]:
    """Bits of a place along an axis, and of a key: the meshes' numbers are above the curve's codes."""
    bits = int(COARSE_BITS if tree.count <= FEW else FINE_BITS)
    return bits, 3 * bits + (0 if fillers else (meshes - 1).bit_length())


def _is_ranked(tree: Tree, device: Any, meshes: int, fillers: bool) -> bool:
    return device.is_cuda and is_ranked(tree.face.shape[0], meshes, fillers, _bits(tree, meshes, fillers)[1])


def build_in_frame(
    tree: Tree,
    vertices: wp.array,
    faces: wp.array,
    bounds: wp.array,
    keys: wp.array,
    slots: wp.array,
    normals: wp.array,
    gathered: Callable[[], None] | None = None,
    *,
    fillers: bool = False,
    counts: wp.array | None = None,
) -> None:
    """`build_tree` of which the frame, and the bounds of what lies within it, are there already."""
    device = vertices.device
    meshes, total = vertices.shape[0], tree.face.shape[0]
    bits, all_bits = _bits(tree, meshes, fillers)
    inputs = [tree, vertices, faces, bounds, bits, int(not fillers)]
    order = slots
    if _is_ranked(tree, device, meshes, fillers):
        ranks = RankSort(keys, slots, all_bits, counts)
        inputs += [ranks.short, slots, ranks.counts]
        launch(_make_short_keys, total, inputs, device, smallest=CURVE_SHARE)
        order = ranks.order(tree)
    elif short_keys(total, all_bits) if device.is_cuda else all_bits <= SHORT_BITS:
        short, none = (array_at(keys.ptr, (n,), wp.int32, device.alias) for n in (2 * total, 0))
        launch(_make_short_keys, total, [*inputs, short, slots, none], device, smallest=CURVE_SHARE)
        wp.utils.radix_sort_pairs(short, slots, total, end_bit=all_bits)
    else:
        launch(_make_keys, total, [*inputs, keys, slots], device, smallest=CURVE_SHARE)
        wp.utils.radix_sort_pairs(keys, slots, total, end_bit=all_bits)
    launch(_gather_triangles, total, [vertices, faces, order, tree, normals], device, smallest=LIGHT_SHARE)
    if gathered is not None:
        gathered()
    bound_nodes(tree, meshes)
