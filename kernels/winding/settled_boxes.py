"""Winding numbers of a box's voxels by the field of an open mesh's caps, written where that leaves no doubt.

What is written is never a whole number, so that the voxels that still have whole ones are what is left.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.geometry.block_table import VOXELS, inner_of
from sdm.kernels.geometry.voxel_box import VoxelBox, is_within
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, voxel
from sdm.kernels.primitives.lanes import (
    ballot,
    bits_of_some,
    on_cpu,
    one_on_cpu,
    sum_of_some,
)
from sdm.kernels.winding.cap_field import ONE_OVER_FULL, Field, doubt, largest_share, most_change, share_at
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import Sixteen, eight_angles, place_in_box
from sdm.kernels.winding.near_caps import FULL, UNIT, near_angle

wp.set_module_options({"enable_backward": False})

# With a larger error the voxels are not looked at: too many would be in doubt.
MOST_DOUBT = 0.15
# Less than a quarter, by more than the rounding of the sums.
LARGEST_SHARE = 0.249
# What float32 adds to a winding number's error when all is summed up, and in proportion to the number.
LAST_ROUNDINGS, LAST_ROUNDING = 2.0e-6, 3.0e-7


@wp.func
def is_sure(winding: float, whole: float, error: float):
    """True if a winding number is on a known side of the values that decide about sign and clearness."""
    off = wp.min(wp.abs(winding - 0.25), wp.min(wp.abs(winding - 0.5), wp.abs(winding - 0.75)))
    return off > error + LAST_ROUNDINGS + LAST_ROUNDING * wp.abs(whole)


@wp.func
def is_whole(winding: float):
    """True if a voxel still has the winding number of surface and caps."""
    return winding == wp.floor(winding)


@wp.func
def opened(winding: float):
    """A winding number as it is written: never a whole one, which would tell that the voxel is not open yet."""
    return wp.where(is_whole(winding), winding + 0.0625, winding)


@wp.struct
class BlockWindings:
    """Winding numbers of blocks of 8^3 voxels, see `geometry.block_table`, of which one is looked at."""

    values: wp.array(dtype=wp.float32)  # (N * 512)
    place: wp.int32


@wp.func
def winding_at(values: wp.array4d(dtype=wp.float32), mesh: int, v: wp.vec3i):
    """The winding number of a voxel, of all or of one block's."""
    return values[mesh, v[0], v[1], v[2]]


@wp.func
def winding_at(values: BlockWindings, mesh: int, v: wp.vec3i):  # noqa: F811
    return values.values[VOXELS * values.place + inner_of(v)]


@wp.func
def put_winding(values: wp.array4d(dtype=wp.float32), mesh: int, v: wp.vec3i, winding: float):
    """Write it."""
    values[mesh, v[0], v[1], v[2]] = winding


@wp.func
def put_winding(values: BlockWindings, mesh: int, v: wp.vec3i, winding: float):  # noqa: F811
    values.values[VOXELS * values.place + inner_of(v)] = winding


@wp.func
def settle_box(
    field: Field,
    caps: Caps,
    stack: wp.array(dtype=wp.int32),
    slab: Slab,
    mesh: int,
    start: wp.vec3i,
    bits: int,
    last: bool,
    most_near: int,
    box: VoxelBox,
    scale: float,
    listed_at: int,
    lane: int,
    lanes: int,
    idle: bool,
    values: Any,
):
    """Open the voxels of a box that the field leaves in no doubt; the octants that hold others, a bit for each.

    Where the whole numbers of all of them will do, they are left, unless this is the last look at the box.
    `lanes` may be a part of a group, of which each has a box of its own with its near caps at `listed_at`: boxes are of
    one size, and a part without any is idle.
    """
    change = most_change(field, box.half)
    far = largest_share(field, change) < LARGEST_SHARE
    hopeless = field.near > most_near or doubt(field) > MOST_DOUBT
    look = not idle and (far or not hopeless)
    left = int(0)
    if not idle and hopeless and not far:
        left = int(255)
    if far and not last:
        look = bool(False)
    if ballot(look) != wp.uint32(0):
        # Lanes for each voxel: all of a single one.
        share = one_on_cpu(wp.max(1, lanes >> (3 * bits)))
        together = on_cpu() and bits > 0 and field.near > 0
        angles = Sixteen()
        # Where the share at the centre leaves no side open for any whole number, it is that of all voxels.
        middle = float(field.value) * ONE_OVER_FULL
        error = doubt(field)
        plain = far or (field.near == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change))
        if plain:
            error = error + change
        number = lane / share
        step = lanes / share
        while number < 1 << (3 * bits):
            at = place_in_box(number, bits)
            v = start + at
            if together and (number & 7) == 0:
                angles = eight_angles(caps, field.near, slab_of(slab, mesh), start, bits, number, scale, stack)
            whole = float(0.5)
            if look and is_within(slab, v):
                whole = winding_at(values, mesh, v)
            angle = float(0.0)
            wrong = float(0.0)
            far_share = middle
            p = wp.vec3()
            active = is_whole(whole) and not plain
            if active:
                p = scale * voxel(slab_of(slab, mesh), v[0], v[1], v[2])
                far_share = share_at(field, p - box.centre)
                if together:
                    angle = angles[number & 7]
                    wrong = angles[8 + (number & 7)]
            if ballot(active and field.near > 0 and not together) != wp.uint32(0):
                near = wp.where(look and not plain, field.near, 0)
                angle, wrong = near_angle(caps, near, active, p, stack, listed_at, lane & (share - 1), share, lanes)
            if bits > 0 and share > 1:
                # Also, all have read the whole number before it goes.
                angle = sum_of_some(angle, share)
                wrong = sum_of_some(wrong, share) + 2.0 * UNIT * FULL
            winding = whole
            if not far:
                winding = whole - angle * ONE_OVER_FULL - far_share
            if is_whole(whole):
                if far or is_sure(winding, whole, error + wrong * ONE_OVER_FULL):
                    if (lane & (share - 1)) == 0:
                        put_winding(values, mesh, v, opened(winding))
                else:
                    half = bits - 1
                    left = left | (1 << (4 * (at[0] >> half) + 2 * (at[1] >> half) + (at[2] >> half)))
            number = number + step
    return bits_of_some(left, lanes)


@wp.func
def is_left(slab: Slab, values: Any, mesh: int, v: wp.vec3i):
    """True if a voxel is there, and not open yet."""
    if not is_within(slab, v):
        return False
    return is_whole(winding_at(values, mesh, v))
