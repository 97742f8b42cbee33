"""Octants of a box, a bit for each: which are to be opened, and how many of them at a time."""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.voxel_box import is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.primitives.lanes import unknown
from sdm.kernels.winding.near_caps import NEAR_EACH
from sdm.kernels.winding.settled_boxes import is_whole

wp.set_module_options({"enable_backward": False})


@wp.func
def octants_to_open(slab: Slab, values: wp.array4d(dtype=wp.float32), mesh: int, at: wp.vec3i, bits: int, some: int):
    """Of `some` octants of a box, a bit for each, those of 2^bits voxels that are there, or voxels that are left."""
    found = int(0)
    for octant in range(unknown(8)):
        child = 2 * at + octant_at(octant)
        here = is_within(slab, wp.vec3i(child[0] << bits, child[1] << bits, child[2] << bits))
        if here and bits == 0:
            here = is_whole(values[mesh, child[0], child[1], child[2]])
        if here:
            found = found | (1 << octant)
    return found & some


@wp.func
def is_one(bits: int):
    """True if a single bit is set, or none."""
    return (bits & (bits - 1)) == 0


@wp.func
def count_bits(bits: int):
    """Number of bits that are set, of eight."""
    pairs = bits - ((bits >> 1) & 0x55)
    fours = (pairs & 0x33) + ((pairs >> 2) & 0x33)
    return (fours + (fours >> 4)) & 0xF


@wp.func
def parts_of_lanes(octants: int, near: int, lanes: int):
    """Parts of a group of lanes that look at octants beside each other, if so much was near to the box around them."""
    parts = int(1)
    while parts < count_bits(octants) and 2 * parts <= lanes and 2 * parts * near <= NEAR_EACH * lanes:
        parts = 2 * parts
    return parts
