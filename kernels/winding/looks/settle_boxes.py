"""Winding numbers of recorded boxes' voxels, by their fields and near caps: written where that leaves no doubt."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE
from sdm.kernels.geometry.voxel_box import box_of_voxels, is_within
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import ballot, bits_of_lanes
from sdm.kernels.winding.cap_field import ONE_OVER_FULL, doubt, most_change, share_at
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.looks.count_places import LENGTH, NEXT_RECORD, RECORDED, STRIDE
from sdm.kernels.winding.looks.near_pair import near_pair
from sdm.kernels.winding.looks.records import ROW, Records, read_field
from sdm.kernels.winding.settled_boxes import is_sure, is_whole, opened

wp.set_module_options({"enable_backward": False})

# Thread blocks, of 128 threads, that a multiprocessor holds at a time.
BLOCKS = 5


@wp.func
def whole_at(slab: Slab, values: wp.array4d(dtype=wp.float32), mesh: int, v: wp.vec3i):
    """The winding number of a voxel that is there and not open yet, else one that is not whole."""
    whole = float(0.5)
    if is_within(slab, v):
        whole = values[mesh, v[0], v[1], v[2]]
    return whole


@wp.func
def octant_in_box(inner: wp.vec3i, bits: int):
    """A bit for the octant of a box of 2^bits voxels along each edge that a voxel is in."""
    half = bits - 1
    return 1 << (4 * (inner[0] >> half) + 2 * (inner[1] >> half) + (inner[2] >> half))


@wp.kernel(launch_bounds=(128, BLOCKS))
def settle_boxes(
    begin: int,
    caps: Caps,
    slab: Slab,
    bits: int,
    cells: wp.vec3i,
    level: int,
    records: Records,
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open the voxels of recorded boxes of 2^bits voxels along each edge; list those with others, and their octants."""
    lane = (begin + wp.tid()) % lanes
    total = wp.min(counts[STRIDE * level + RECORDED], records.rows.shape[0] / ROW)
    item = fetch_add_once(counts, STRIDE * level + NEXT_RECORD, 1, lane)
    while item < total:
        here = records.rows[ROW * item]
        if here >= 0:
            place = records.rows[ROW * item + 2]
            field = read_field(records, item)
            mesh, at = unravel(here, cells)
            start = wp.vec3i(at[0] << bits, at[1] << bits, at[2] << bits)
            scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
            box = box_of_voxels(slab_of(slab, mesh), start, 1 << bits, scale)
            change = most_change(field, box.half)
            # Where the share at the centre leaves no side open for any whole number, it is that of all voxels.
            middle = float(field.value) * ONE_OVER_FULL
            error = doubt(field)
            plain = field.near == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change)
            error = error + wp.where(plain, change, 0.0)
            undone = int(0)
            number = lane
            while number - lane < 1 << (3 * bits):
                inner = place_in_box(number, bits)
                other_inner = place_in_box(number + lanes, bits)
                v = start + inner
                w = start + other_inner
                whole = whole_at(slab, values, mesh, v)
                other = whole_at(slab, values, mesh, w)
                share = middle
                other_share = middle
                found = wp.vec4()
                active = is_whole(whole)
                other_active = is_whole(other)
                if not plain:
                    p = scale * voxel(slab_of(slab, mesh), v[0], v[1], v[2])
                    q = scale * voxel(slab_of(slab, mesh), w[0], w[1], w[2])
                    share = share_at(field, p - box.centre)
                    other_share = share_at(field, q - box.centre)
                    if field.near > 0 and ballot(active or other_active) != wp.uint32(0):
                        found = near_pair(caps.tree.corners, field.near, p, q, records.near, place)
                if active:
                    winding = whole - found[0] * ONE_OVER_FULL - share
                    if is_sure(winding, whole, error + found[1] * ONE_OVER_FULL):
                        values[mesh, v[0], v[1], v[2]] = opened(winding)
                    else:
                        undone = undone | octant_in_box(inner, bits)
                if other_active:
                    winding = other - found[2] * ONE_OVER_FULL - other_share
                    if is_sure(winding, other, error + found[3] * ONE_OVER_FULL):
                        values[mesh, w[0], w[1], w[2]] = opened(winding)
                    else:
                        undone = undone | octant_in_box(other_inner, bits)
                number = number + 2 * lanes
            undone = bits_of_lanes(undone)
            if lane == 0 and undone != 0:
                listed = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
                left[listed] = here
                left_octants[listed] = undone
        item = fetch_add_once(counts, STRIDE * level + NEXT_RECORD, 1, lane)
