"""Winding numbers of a mesh with few boundary edges on a CPU, boxes of 8^3 voxels first.

Most voxels' winding numbers are far from those that decide about sign and clearness, so that a rough look will do. A
box of 8^3 looks at all edges once, and hands the field of the far ones down to its octants (`handed_fields`), which
look at nothing but what is near the box. What is left in doubt is looked at again, more closely (`boxes_by_edges`), or
summed up where it is a few voxels.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.primitives.wide_numbers import SIXTEEN
from sdm.kernels.winding.cap_field import ONE_OVER_FULL, doubt, most_change
from sdm.kernels.winding.eights.box_strips import ERROR, SHARE, VOXELS, X, Y, Z, strips_of_box
from sdm.kernels.winding.eights.box_strips import ROOM as PLACES
from sdm.kernels.winding.eights.box_voxels import OCTANTS, settle_voxels, write_voxels
from sdm.kernels.winding.eights.handed_fields import (
    FOUND_ACROSS,
    FOUND_NEAR,
    LargeLook,
    handed_down,
    keep_edges,
    look_at_kept,
    look_at_large,
)
from sdm.kernels.winding.eights.packed_edges import ROW
from sdm.kernels.winding.near_caps import FULL, UNIT
from sdm.kernels.winding.rims.radial_strips import ACROSS_BOX, NEAR, Look
from sdm.kernels.winding.rims.strip_looks import ASIDE, ROOM, WIDER, field_of
from sdm.kernels.winding.settled_boxes import is_sure

wp.set_module_options({"enable_backward": False})

_ROOM = ROOM["cpu"]
# Of boxes.
LARGE_BITS = 3
# The most edges near a box and across it that its octants look at, and the numbers of these.
MOST_KEPT = 1024
KEPT = ROW * (MOST_KEPT // SIXTEEN + 1)
# What an edge's polynomial may leave out of the solid angle, for the box and for its octants.
FOR_LARGE, FOR_OCTANTS = 2e-2, 0.15
# A box of 4^3 that has no more voxels in doubt is not looked at again.
FEW_VOXELS = 6
# A winding number may be as far from those that decide, as it is in many parts that lie in each other.
MOST_ERROR = 16.0
# Where the centres of octants are among the places of voxels.
_CENTRES = VOXELS * 8


@wp.func
def field_of_part(large: LargeLook, h: wp.vec3, share: float, error: float, look: Look):
    """The field of a part of a box about a place at h from the box's centre.

    It has what is far from the box, the share there of strips of what is near, with its error, and what the part has
    seen of that.
    """
    field = field_of(handed_down(large, h), 1)
    more = field_of(look, 1)
    field.value = field.value + wp.float64(FULL * share)
    field.slope = field.slope + more.slope
    field.squares = field.squares + more.squares
    field.products = field.products + more.products
    field.cubes = field.cubes + more.cubes
    # As `cap_field.moved_field` has it.
    field.error = field.error + 96.0 * UNIT * field.drift + FULL * error + more.error
    field.drift = field.drift + more.drift
    return field


@wp.kernel
def open_by_octants(
    begin: int,
    tree: Tree,
    rows: wp.array(dtype=wp.float32),
    packed: wp.array(dtype=wp.int32),
    blocks: int,
    slab: Slab,
    large_tolerance: float,
    tolerance: float,
    cells: wp.vec3i,
    small_cells: wp.vec3i,
    again: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    next_item: int,
    looked: int,
    length_again: int,
    length: int,
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.float32),
    kept: wp.array(dtype=wp.float32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open voxels of boxes of 8^3, `cells` along each axis; list boxes of 4^3, `small_cells` along each axis, that are
    to be looked at again, and those with a few voxels in doubt, with the octants that hold these.

    `next_item`, `looked` and the lengths are places of the counts.
    """
    stack = large_stack_of(stacks, begin + wp.tid())
    at_places = (begin + wp.tid()) * PLACES
    at_kept = (begin + wp.tid()) * KEPT
    total = values.shape[0] * cells[0] * cells[1] * cells[2]
    across_room = LARGE_STACK_ON_CPU - _ROOM
    item = fetch_add_once(counts, next_item, 1, 0)
    while item < total:
        mesh, at = unravel(item, cells)
        scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
        here = slab_of(slab, mesh)
        start = 8 * at
        box = box_of_voxels(here, start, 8, scale)
        c = box.centre + wp.cw_mul(ASIDE, box.half)
        half = WIDER * box.half
        radius = wp.length(half)
        large = look_at_large(
            rows, mesh * blocks, packed[mesh], c, radius, half, large_tolerance, stack, 0, _ROOM, _ROOM, across_room
        )
        near = int(large[FOUND_NEAR])
        across = int(large[FOUND_ACROSS])
        own = field_of(handed_down(large, wp.vec3()), 1)
        change = most_change(own, half)
        middle = float(own.value) * ONE_OVER_FULL
        # Of a part of a box octants may be no less far from its centre than voxels.
        known = doubt(own) < MOST_ERROR and near + across <= MOST_KEPT
        for axis in range(3):
            known = known and start[axis] + 8 <= here.shape[axis]
        plain = near + across == 0 and is_sure(middle - wp.floor(middle), 1.0, doubt(own) + change)
        if known and not plain:
            # Twice, as so many voxels are looked at together.
            centres = int(SIXTEEN)
            for k in range(centres):
                small = box_of_voxels(here, start + 4 * octant_at(k & 7), 4, scale)
                p = small.centre + wp.cw_mul(ASIDE, small.half)
                places[at_places + _CENTRES + X + k] = p[0]
                places[at_places + _CENTRES + Y + k] = p[1]
                places[at_places + _CENTRES + Z + k] = p[2]
            strips_of_box(
                rows, mesh * blocks, stack, 0, near, _ROOM, across, c, radius, places, at_places + _CENTRES, SIXTEEN, 1
            )
            keep_edges(rows, mesh * blocks, stack, 0, near, _ROOM, across, kept, at_kept)
        octants = int(8)
        for octant in range(octants):
            corner = start + 4 * octant_at(octant)
            if is_within(here, corner):
                undone = int(-1)
                if plain:
                    undone = settle_voxels(
                        own, here, values, mesh, corner, places, at_places, c, True, False, 1.0, change
                    )
                elif known:
                    small = box_of_voxels(here, corner, 4, scale)
                    at_centre = at_places + _CENTRES + octant
                    p = wp.vec3(places[at_centre + X], places[at_centre + Y], places[at_centre + Z])
                    small_half = WIDER * small.half
                    small_radius = wp.length(small_half)
                    look = look_at_kept(
                        kept, at_kept / ROW, near, across, p, small_radius, small_half, tolerance,
                        stack, 0, _ROOM, _ROOM, across_room,
                    )  # fmt: skip
                    field = field_of_part(large, p - c, places[at_centre + SHARE], places[at_centre + ERROR], look)
                    listed = look[NEAR] + look[ACROSS_BOX] > 0.0
                    if doubt(field) < MOST_ERROR:
                        write_voxels(here, corner, scale, places, at_places)
                        if listed:
                            strips_of_box(
                                kept, at_kept / ROW, stack, 0, int(look[NEAR]), _ROOM, int(look[ACROSS_BOX]), p,
                                small_radius, places, at_places, 64, 15,
                            )  # fmt: skip
                        undone = settle_voxels(
                            field, here, values, mesh, corner, places, at_places, p, False, listed, 1.0, 0.0
                        )
                if undone != 0:
                    cell = wp.vec3i(corner[0] / 4, corner[1] / 4, corner[2] / 4)
                    number = ((mesh * small_cells[0] + cell[0]) * small_cells[1] + cell[1]) * small_cells[2] + cell[2]
                    if undone > 0 and undone / OCTANTS <= FEW_VOXELS:
                        place = fetch_add(counts, length, 1)
                        left[place] = number
                        left_octants[place] = undone & 255
                    else:
                        again[fetch_add(counts, length_again, 1)] = number
        fetch_add(counts, looked, 1)
        item = fetch_add_once(counts, next_item, 1, 0)
