"""Winding numbers of a mesh with few boundary edges, by the edges alone: without caps or a tree.

The winding number is the crossings of the surface plus the boundary's share (`boundary_term`), and changes within a box
of voxels, where it does not jump, by the boundary alone (Biot and Savart): so a box gets the share at its centre, by
the sum over all edges (`rim_sums`), and Taylor polynomials of the edges that are far for its size (`cap_taylor`).

The share of an edge is that of a strip, which has two half lines for its sides (`half_line`): it is far if all three,
and what is between them, are far. As each edge begins where another ends, the half lines of all edges cancel, and
those of the far ones are those of the others turned round; of these only what is far, as an edge that has a near half
line is not far at either side of it. What the others add is summed up for each voxel.

A box of 8^3 voxels looks at all edges, its octants at those that were not far for it; what is left in doubt gets the
sum over all edges (`open_rims`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    GPU_LANES,
    ballot,
    bits_of_lanes,
    gpu_workers,
    members,
    rank,
    sum_of_lanes,
    unknown,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import LARGE_STACK, LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.boundary_term import Boundary, edges_of
from sdm.kernels.winding.cap_descent import sum_of_parts
from sdm.kernels.winding.cap_field import Field, cubes_of, doubt, largest_share, most_change, moved_field, share_at
from sdm.kernels.winding.cap_taylor import Taylor, add_edge
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.near_caps import FULL, UNIT, WIDER
from sdm.kernels.winding.open_caps import ALONE, BITS, COUNTS, EXACT, LENGTH, LOOKED, NEXT, STRIDE
from sdm.kernels.winding.open_rims import _open_by_rims
from sdm.kernels.winding.rim_sums import listed_sum, rim_part
from sdm.kernels.winding.settled_boxes import LARGEST_SHARE, MOST_DOUBT, is_sure, is_whole, opened

wp.set_module_options({"enable_backward": False})

# Room in a stack for the edges that are not far for a box, and for an octant.
ROOM = 1152
ROOM_OF_OCTANT = LARGE_STACK - ROOM
# More than rounding takes from the distance of a strip, in shares of the ends' distances.
STRIP_ROOM = 1.0e-6
# The integral of 1/r^5 along a line at a distance of 1, and a rounding more.
WHOLE = 1.3334


@wp.func
def strip_misses(a: wp.vec3, b: wp.vec3, radius: float):
    """True if the strip of an edge whose ends are a and b off does not come within a radius."""
    along_y = b[1] - a[1]
    along_z = b[2] - a[2]
    length2 = along_y * along_y + along_z * along_z
    part = float(0.0)
    if length2 > 0.0:
        part = wp.clamp(-(a[1] * along_y + a[2] * along_z) / length2, 0.0, 1.0)
    y = a[1] + part * along_y
    z = a[2] + part * along_z
    x = wp.min(wp.max(a[0], b[0]), 0.0)
    room = radius * WIDER + STRIP_ROOM * (1.0 + wp.length(a) + wp.length(b))
    return x * x + y * y + z * z > room * room


@wp.func
def half_line(a: wp.vec3, sense: float, radius: float):
    """Taylor polynomial of a half line from a way off along -x: `cap_taylor.add_edge` for an end without end.

    With h = (-1, 0, 0), A = a/|a|, u = 1/|a| and k = |a| + a.h, and each of k, and of what is added up, right within 16
    and 120 roundings of itself, S = u/k, s = u^2 A/k + u (A + h)/k^2, and H has

        p = 3 u^3/k + 3 u^2/k^2 + r,   q = u^2/k^2 + r,   r = 2 u/k^3,   t = -u^3/k - u^2/k^2.

    The terms of the order m = 4 and more are at most the integral of R^m/r^(m+1) along it, which is 4/3 rho^m of a whole
    line, and half of that where it leads away.
    """
    t = Taylor()
    aside2 = a[1] * a[1] + a[2] * a[2]
    la = wp.sqrt(a[0] * a[0] + aside2)
    k = la + wp.abs(a[0])
    d = la
    if a[0] > 0.0:
        k = aside2 / k
        d = wp.sqrt(aside2)
    d = 0.999 * d - 1.0e-6 * la
    t.bound = float(wp.inf)
    if d > 2.0 * radius and k > 0.0:
        rho = radius / d
        t.bound = wp.where(a[0] > 0.0, WHOLE, 0.5 * WHOLE) * (rho * rho * rho * rho) / (1.0 - rho)
        u = 1.0 / la
        ik = 1.0 / k
        h = wp.vec3(-1.0, 0.0, 0.0)
        along = u * a
        normal = sense * wp.cross(a, h)
        s1 = u * ik
        s = (u * s1) * along + (s1 * ik) * (along + h)
        r = 2.0 * s1 * ik * ik
        p = 3.0 * u * s1 * (u + ik) + r
        q = s1 * s1 + r
        level = -u * s1 * (u + ik)
        t.slope = s1 * normal
        t.squares = 0.5 * wp.cw_mul(normal, s)
        t.products = 0.5 * wp.vec3(
            normal[0] * s[1] + normal[1] * s[0],
            normal[0] * s[2] + normal[2] * s[0],
            normal[1] * s[2] + normal[2] * s[1],
        )
        ga = p * along + q * h
        gb = q * along + r * h
        squares = wp.cw_mul(ga, along) + wp.cw_mul(gb, h)
        sixth = normal / 6.0
        xy = 2.0 * (ga[0] * along[1] + gb[0] * h[1])
        xz = 2.0 * (ga[0] * along[2] + gb[0] * h[2])
        yz = 2.0 * (ga[1] * along[2] + gb[1] * h[2])
        t.cubes = cubes_of(sixth, level * sixth, squares, xy, xz, yz)
        flat = wp.sqrt(aside2)
        square = wp.length(s) * radius * radius
        cubic = radius * radius * radius * (p + 2.0 * q + r - 3.0 * level) / 3.0
        t.drift = (s1 * radius + square + cubic) * flat
        t.rounding = UNIT * (120.0 * t.drift + 4.0 * wp.PI / d)
    return t


@wp.func
def half_line_is_far(a: wp.vec3, radius: float, tolerance: float):
    """True if the polynomial of a half line leaves out no more than a tolerance: the same for all edges that end there."""
    aside2 = a[1] * a[1] + a[2] * a[2]
    if a[0] <= 0.0:
        aside2 = aside2 + a[0] * a[0]
    d = 0.999 * wp.sqrt(aside2) - 1.0e-6 * wp.length(a)
    rho = radius / d
    reach = wp.where(a[0] > 0.0, WHOLE, 0.5 * WHOLE)
    return d > 2.0 * radius and reach * (rho * rho * rho * rho) <= tolerance * (1.0 - rho)


@wp.func
def with_polynomial(field: Field, t: Taylor):
    """A field and a polynomial."""
    field.slope = field.slope + t.slope
    field.squares = field.squares + t.squares
    field.products = field.products + t.products
    field.cubes = field.cubes + t.cubes
    field.error = field.error + WIDER * t.bound + t.rounding
    field.drift = field.drift + t.drift
    return field


@wp.struct
class Seen:
    """What is known of the edges for a box."""

    field: Field
    near: wp.int32  # edges that are not far


@wp.func
def see_edges(
    boundary: Boundary,
    first: int,
    count: int,
    listed: int,
    box: VoxelBox,
    tolerance: float,
    stack: wp.array(dtype=wp.int32),
    start: int,
    place: int,
    room: int,
    begin: Field,
    lane: int,
    lanes: int,
):
    """Add the polynomials of all edges that are far for a box to a field, and list the others in the stack.

    Args:
        boundary: The edges.
        first: The first of them.
        count: How many are looked at.
        listed: 1 if these are listed in the stack, from `start` on.
        box: The box, its voxels within the root of `half2` from its centre.
        tolerance: The largest bound of what an edge's polynomial leaves out.
        stack: Of this group.
        start: See above.
        place: Where in the stack those that are not far go.
        room: For them; if there are more, the error is infinite.
        begin: The field.
        lane: This lane's number.
        lanes: Their number.
    """
    radius = wp.sqrt(box.half2) * WIDER
    seen = Seen()
    if lane == 0:
        seen.field = begin
    steps = float(0.0)
    near = int(0)
    i = lane
    while i - lane < count and near <= room:
        other = bool(False)
        edge = first + i
        if i < count:
            if listed != 0:
                edge = stack[start + i]
            a = boundary.ends[2 * edge] - box.centre
            b = boundary.ends[2 * edge + 1] - box.centre
            t = Taylor()
            t.nearest = float(wp.inf)
            t = add_edge(t, a, b, radius)
            other = not (t.bound <= tolerance and strip_misses(a, b, radius))
            # Both ends before it is known whether any counts, one after the other, as a GPU keeps few instructions.
            for end in range(unknown(2)):
                if not half_line_is_far(wp.where(end == 0, a, b), radius, tolerance):
                    other = bool(True)
            if not other:
                seen.field = with_polynomial(seen.field, t)
                steps = steps + 1.0
            if other == (listed == 0):
                for end in range(unknown(2)):
                    # That of the first end counts against, and all turned round of the others.
                    way = wp.where(end == 0, a, b)
                    sense = wp.where((end == 0) == other, 1.0, -1.0)
                    if not other or half_line_is_far(way, radius, tolerance):
                        seen.field = with_polynomial(seen.field, half_line(way, sense, radius))
                        steps = steps + 1.0
        mask = ballot(other)
        if other and near + rank(mask, lane) < room:
            stack[place + near + rank(mask, lane)] = edge
        near = near + members(mask)
        i = i + lanes
    seen.field.error = seen.field.error + 4.0 * UNIT * (steps + 6.0) * seen.field.drift
    if near > room:
        seen.field.error = float(wp.inf)
    seen.field = sum_of_parts(seen.field, lanes, True)
    seen.near = near
    wait_for_lanes()
    return seen


@wp.func
def with_share(field: Field, found: wp.vec2):
    """A field to which each lane adds a share of the winding number, give or take an error."""
    share = sum_of_lanes(found[0])
    field.value = field.value + wp.float64(FULL * share)
    field.error = field.error + FULL * (sum_of_lanes(found[1]) + 8.0 * UNIT * (1.0 + wp.abs(share)))
    return field


@wp.func
def settle_octant(
    boundary: Boundary,
    field: Field,
    near: int,
    stack: wp.array(dtype=wp.int32),
    place: int,
    slab: Slab,
    mesh: int,
    start: wp.vec3i,
    bits: int,
    box: VoxelBox,
    scale: float,
    lane: int,
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Write the winding numbers of an octant's voxels that are sure; a bit for each octant of it that holds others."""
    left = int(0)
    change = most_change(field, box.half)
    error = doubt(field)
    middle = float(field.value) / FULL
    far = near == 0 and largest_share(field, change) < LARGEST_SHARE
    plain = near == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change)
    if not error < MOST_DOUBT:
        left = int(255)
    elif not far:
        number = lane
        while number < 1 << (3 * bits):
            at = place_in_box(number, bits)
            v = start + at
            whole = float(0.5)
            if is_within(slab, v):
                whole = values[mesh, v[0], v[1], v[2]]
            if is_whole(whole):
                share = middle
                wrong = error + change
                if not plain:
                    p = scale * voxel(slab_of(slab, mesh), v[0], v[1], v[2])
                    found = wp.vec2()
                    if near > 0:
                        found = listed_sum(boundary.ends, stack, place, near, p, 0, 1)
                    share = share_at(field, p - box.centre) + found[0]
                    wrong = error + found[1] + 4.0 * UNIT * wp.abs(found[0])
                if is_sure(whole + share, whole, wrong):
                    values[mesh, v[0], v[1], v[2]] = opened(whole + share)
                else:
                    half = bits - 1
                    left = left | (1 << (4 * (at[0] >> half) + 2 * (at[1] >> half) + (at[2] >> half)))
            number = number + lanes
    return bits_of_lanes(left)


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def _open_by_edges(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    bits: int,
    tolerance: float,
    tolerance_of_octant: float,
    parents: wp.vec3i,
    cells: wp.vec3i,
    fewest: int,
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    next_item: int,
    looked: int,
    length: int,
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open boxes of 2^(bits + 1) voxels along each edge, octant by octant; list what they leave in doubt.

    `parents` boxes and `cells` octants are along each axis. A box is some items of work where there would be fewer than
    `fewest`. `next_item`, `looked` and `length` are places of the counts.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = large_stack_of(stacks, thread / lanes)
    total = values.shape[0] * parents[0] * parents[1] * parents[2]
    pieces = int(1)
    while pieces < 8 and total * pieces < fewest:
        pieces = 2 * pieces
    item = fetch_add_once(counts, next_item, 1, lane)
    while item < total * pieces:
        number = item / pieces
        mesh, at = unravel(number, parents)
        scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
        first = mesh * boundary.count
        count = edges_of(boundary)
        begins = wp.vec3i(at[0] << (bits + 1), at[1] << (bits + 1), at[2] << (bits + 1))
        whole_box = box_of_voxels(slab_of(slab, mesh), begins, 2 << bits, scale)
        whole = Field()
        listed = int(0)
        # The box, then its octants: one loop, as a GPU keeps few instructions at hand.
        for step in range(unknown(9)):
            octant = wp.max(step - 1, 0)
            child = 2 * at + octant_at(octant)
            start = wp.vec3i(child[0] << bits, child[1] << bits, child[2] << bits)
            looks = step == 0
            if octant / (8 / pieces) == item % pieces and is_within(slab, start) and not whole.error < 0.0:
                looks = bool(True)
            if looks:
                box = whole_box
                field = Field()
                found = wp.vec2()
                edges = int(count)
                place = int(0)
                room = int(ROOM)
                allowed = float(tolerance)
                if step == 0:
                    found = rim_part(boundary, mesh, box.centre, lane, lanes)
                else:
                    box = box_of_voxels(slab_of(slab, mesh), start, 1 << bits, scale)
                    field = moved_field(whole, box.centre - whole_box.centre)
                    found = listed_sum(boundary.ends, stack, 0, listed, box.centre, lane, lanes)
                    edges = listed
                    place = ROOM
                    room = ROOM_OF_OCTANT
                    allowed = tolerance_of_octant
                seen = see_edges(
                    boundary, first, edges, wp.where(step == 0, 0, 1), box, allowed, stack, 0, place, room, field, lane,
                    lanes,
                )  # fmt: skip
                near = wp.min(seen.near, room)
                # What is listed is no part of the field: it is added for each octant, or voxel.
                less = listed_sum(boundary.ends, stack, place, near, box.centre, lane, lanes)
                field = with_share(with_share(seen.field, found), wp.vec2(-less[0], less[1]))
                if step == 0:
                    whole = field
                    listed = near
                    if near == 0 and largest_share(whole, most_change(whole, box.half)) < LARGEST_SHARE:
                        # Nothing is in doubt.
                        whole.error = -1.0
                else:
                    undone = settle_octant(
                        boundary, field, near, stack, ROOM, slab, mesh, start, bits, box, scale,
                        lane, lanes, values,
                    )  # fmt: skip
                    if lane == 0:
                        fetch_add(counts, looked, 1)
                        if undone != 0:
                            number_left = fetch_add(counts, length, 1)
                            left[number_left] = (
                                (mesh * cells[0] + child[0]) * cells[1] + child[1]
                            ) * cells[2] + child[2]
                            left_octants[number_left] = undone
                # All have read the list before another takes its place.
                wait_for_lanes()
        item = fetch_add_once(counts, next_item, 1, lane)


# A mesh with no more boundary edges than this is opened by them: others by caps.
MOST_EDGES = {"cuda": 3000, "cpu": 0}
# What an edge's polynomial may leave out of the winding number, for a box and for an octant.
TOLERANCES = {"cuda": (3e-5, 1e-4), "cpu": (3e-5, 1e-4)}
# Boxes have 8^3 voxels, and octants 4^3, if there are so many of them; else half of that along each edge.
FEWEST_BOXES = {"cuda": 2048, "cpu": 64}


def open_edges(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> wp.array:
    """From the crossings of the surface to its winding numbers, where it matters for sign or clearness.

    Changes `values` (meshes, n, ny, nz) float32. `empty(length, dtype)` allocates workspace. Returns the
    counts, as `open_caps` has them.
    """
    device = values.device
    meshes, *shape = values.shape
    lanes, workers, fewest = 1, 16 * threads(), 0
    if device.is_cuda:
        lanes, workers = GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)
        fewest = workers
    kind = "cuda" if device.is_cuda else "cpu"
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    stacks = empty(1 if device.is_cuda else workers * LARGE_STACK_ON_CPU, wp.int32)
    bits = 2 if meshes * math.prod(-(-n >> 3) for n in shape) >= FEWEST_BOXES[kind] else 1
    level = BITS.index(bits)
    parents, cells = (wp.vec3i(*(-(-n >> size) for n in shape)) for size in (bits + 1, bits))
    left, left_octants = (empty(meshes * cells[0] * cells[1] * cells[2], wp.int32) for _ in range(2))
    at, after = STRIDE * level, STRIDE * (level + 1)
    inputs = [tree, boundary, slab, bits, *(FULL * one for one in TOLERANCES[kind]), parents, cells, fewest]
    inputs += [left, left_octants, at + NEXT, at + LOOKED, after + LENGTH, counts, stacks, lanes, values]
    launch(_open_by_edges, workers * lanes, inputs, device, smallest=1)
    inputs = [tree, boundary, caps, 1, slab, bits, cells, fewest, left, left_octants]
    inputs += [after + LENGTH, after + NEXT, STRIDE * ALONE + LOOKED, EXACT, counts, lanes, values]
    launch(_open_by_rims, workers * lanes, inputs, device, smallest=1)
    return counts
