"""Opening of an open mesh's caps on a CPU in boxes of 8^3 voxels and more, by their fields and few near caps."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE
from sdm.kernels.geometry.voxel_box import box_of_voxels, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import bit_at
from sdm.kernels.primitives.shared_stacks import large_stack_of
from sdm.kernels.winding.cap_descent import see_caps
from sdm.kernels.winding.cap_field import Field, moved_field
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.looks.count_places import LENGTH, LOOKED, NEXT, STRIDE
from sdm.kernels.winding.near_caps import NEAR_LIST, WIDER
from sdm.kernels.winding.octants import is_one, octants_to_open
from sdm.kernels.winding.settled_boxes import settle_box

wp.set_module_options({"enable_backward": False})


@wp.kernel
def open_large_boxes(
    begin: int,
    caps: Caps,
    slab: Slab,
    bits: int,
    tolerance: float,
    listed: int,
    settled: int,
    parents: wp.vec3i,
    cells: wp.vec3i,
    level: int,
    first: int,
    boxes: wp.array(dtype=wp.int32),
    octants: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open octants, of 2^bits voxels along each edge, of boxes; list those that are left in doubt, with theirs."""
    stack = large_stack_of(stacks, begin + wp.tid())
    total = values.shape[0] * parents[0] * parents[1] * parents[2]
    if first == 0:
        total = counts[STRIDE * level + LENGTH]
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, 0)
    while item < total:
        number = item
        some = int(255)
        if first == 0:
            some = octants[item]
            number = boxes[item]
        mesh, at = unravel(number, parents)
        some = octants_to_open(slab, values, mesh, at, bits, some)
        scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
        whole = Field()
        whole.error = float(wp.inf)
        middle = wp.vec3()
        reach = float(0.0)
        # First the box, then its octants.
        keep = not is_one(some)
        while some != 0:
            child = 2 * at
            size = 2 << bits
            if not keep:
                child = child + octant_at(bit_at(some, 0))
                size = 1 << bits
            start = wp.vec3i(child[0] << bits, child[1] << bits, child[2] << bits)
            box = box_of_voxels(slab_of(slab, mesh), start, size, scale)
            radius = wp.sqrt(box.half2)
            field = Field()
            handed = int(-1)
            if keep:
                middle = box.centre
                radius = radius * WIDER
                reach = radius
            else:
                way = box.centre - middle
                if whole.error < wp.inf and wp.length(way) + radius <= reach:
                    field = moved_field(whole, way)
                    handed = whole.near
            field = see_caps(
                caps, mesh, box.centre, radius, tolerance, listed, field, handed, keep, True, 0, stack, 0, 1, 1, False
            )
            if keep:
                whole = field
                keep = bool(False)
            else:
                undone = settle_box(
                    field, caps, stack, slab, mesh, start, bits, False, settled, box, scale, NEAR_LIST, 0, 1, False,
                    values,
                )  # fmt: skip
                fetch_add(counts, STRIDE * level + LOOKED, 1)
                if undone != 0:
                    place = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
                    left[place] = ((mesh * cells[0] + child[0]) * cells[1] + child[1]) * cells[2] + child[2]
                    left_octants[place] = undone
                some = some & (some - 1)
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, 0)
