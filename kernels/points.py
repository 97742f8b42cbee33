"""Queries at scattered points.

Points are sorted along the tree's curve, so that neighbours follow each other, and taken in groups. What a group knows
saves each of its points most of the work: a triangle near its middle, to begin the search with, and, of an open mesh,
whether its holes are so far away that they cannot decide about the sign of any of its points (see `caps`).
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.caps import is_far, may_cover, view_caps
from sdm.kernels.closest import nearest_slot
from sdm.kernels.cull import Cell
from sdm.kernels.curve import CURVE_BITS, curve_code
from sdm.kernels.geometry import closest_point
from sdm.kernels.lanes import GPU_LANES, least_of_lanes
from sdm.kernels.tree import SCALE, UNSCALE, Tree, node_box
from sdm.kernels.winding import CLOSED, SOUP, Winding, inside_at, winding_at

wp.set_module_options({"enable_backward": False})

_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)
_CLOSED, _SOUP = wp.constant(CLOSED), wp.constant(SOUP)
# Neighbours along the curve that one thread takes one after the other, each from the answer before it. A GPU would
# rather have more threads.
CPU_RUN = 8
# Neighbours along the curve that share what is known of their surroundings.
GROUP = 32
_GROUP = wp.constant(GROUP)


@wp.func
def is_finite(p: wp.vec3):
    return wp.isfinite(p[0]) and wp.isfinite(p[1]) and wp.isfinite(p[2])


@wp.func
def numbered(order: wp.array(dtype=wp.int32), at: int):
    """Which point is the one at a place in the order, which may be empty: as they come."""
    if order.shape[0] > 0:
        return order[at]
    return at


@wp.kernel
def _point_keys(
    begin: int,
    points: wp.array(dtype=wp.vec3),
    tree: Tree,
    keys: wp.array(dtype=wp.int64),
    order: wp.array(dtype=wp.int32),
):
    i = begin + wp.tid()
    p = float(tree.frame[_SCALE]) * points[i]
    # Twice the mesh's box: most points that people ask for are inside it.
    low, high = node_box(tree, 1)
    middle = 0.5 * (low + high)
    keys[i] = wp.int64(curve_code(p, 2.0 * low - middle, 2.0 * high - middle))
    order[i] = i


@wp.kernel
def _look_around(
    begin: int,
    lanes: int,
    tree: Tree,
    winding: Winding,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    groups: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    group = thread / lanes
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    negated_high = low
    at = _GROUP * group + lane
    while at < wp.min(_GROUP * (group + 1), points.shape[0]):
        i = numbered(order, at)
        if is_finite(points[i]):
            p = float(tree.frame[_SCALE]) * points[i]
            low = wp.min(low, p)
            negated_high = wp.min(negated_high, -p)
        at = at + lanes
    low = wp.vec3(least_of_lanes(low[0]), least_of_lanes(low[1]), least_of_lanes(low[2]))
    high = -wp.vec3(least_of_lanes(negated_high[0]), least_of_lanes(negated_high[1]), least_of_lanes(negated_high[2]))
    hint = int(0)
    cell = Cell()
    cell.centre = 0.5 * (low + high)
    if low[0] <= high[0] and is_finite(cell.centre):
        cell.half = wp.max(high - cell.centre, cell.centre - low) * 1.000001
        cell.half2 = wp.dot(cell.half, cell.half)
        if winding.kind != _CLOSED and winding.kind != _SOUP:
            if is_far(view_caps(winding.boundary, 0, cell, lane, lanes)):
                hint = wp.where(may_cover(winding.boundary, 0, cell, lane, lanes), 3, 1)
    else:
        cell.centre = wp.vec3(0.0, 0.0, 0.0)
    if lane == 0:
        groups[group] = 4 * nearest_slot(tree, 0, cell.centre, 0) + hint


@wp.kernel
def _query(
    begin: int,
    length: int,
    tree: Tree,
    winding: Winding,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    groups: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    want_hits: int,
    hit_points: wp.array(dtype=wp.vec3),
    hit_faces: wp.array(dtype=wp.int32),
    hit_barycentric: wp.array(dtype=wp.vec3),
):
    run = begin + wp.tid()
    total = points.shape[0]
    known = int(0)
    if run * length < total:
        known = groups[run * length / _GROUP]
    guess = known >> 2
    far = (known & 1) != 0
    covered = (known & 2) != 0
    scale = tree.frame[_SCALE]
    unscale = tree.frame[_UNSCALE]
    # The bound is a variable so that Warp does not write the loop out.
    steps = int(length)
    for step in range(steps):
        at = run * steps + step
        if at < total:
            i = numbered(order, at)
            point = points[i]
            if is_finite(point):
                p = float(scale) * point
                exact = scale * wp.vec3d(point)
                guess = nearest_slot(tree, 0, p, guess)
                hit = closest_point(
                    exact,
                    wp.vec3d(tree.corners[4 * guess]),
                    wp.vec3d(tree.corners[4 * guess + 1]),
                    wp.vec3d(tree.corners[4 * guess + 2]),
                )
                distance = float(wp.sqrt(hit.distance2) * unscale)
                if inside_at(tree, winding, exact, far, covered):
                    distance = -distance
                values[i] = distance
                if want_hits != 0:
                    hit_points[i] = wp.vec3(unscale * hit.point)
                    hit_faces[i] = tree.face[guess]
                    hit_barycentric[i] = wp.vec3(hit.barycentric)
            else:
                values[i] = float(wp.nan)
                if want_hits != 0:
                    hit_points[i] = wp.vec3(wp.nan, wp.nan, wp.nan)
                    hit_faces[i] = -1
                    hit_barycentric[i] = wp.vec3(wp.nan, wp.nan, wp.nan)


@wp.kernel
def _winding(
    begin: int, tree: Tree, winding: Winding, points: wp.array(dtype=wp.vec3), values: wp.array(dtype=wp.float32)
):
    i = begin + wp.tid()
    values[i] = float(wp.nan)
    if is_finite(points[i]):
        values[i] = winding_at(tree, winding, 0, tree.frame[_SCALE] * wp.vec3d(points[i]))


def sort_points(points: wp.array, tree: Tree, keys: wp.array, order: wp.array, launch: Any) -> None:
    """Fill `order` with the points' order along the tree's curve.

    Args:
        points: (N,) vec3.
        tree: One mesh's hierarchy.
        keys: (2N,) int64, scratch.
        order: (2N,) int32, filled: the first N are the order.
        launch: `sdm.kernels.launch.launch`.
    """
    count = points.shape[0]
    launch(_point_keys, count, [points, tree, keys, order], points.device)
    wp.utils.radix_sort_pairs(keys, order, count, end_bit=3 * CURVE_BITS)


def query_points(
    tree: Tree,
    winding: Winding,
    points: wp.array,
    order: wp.array,
    groups: wp.array,
    values: wp.array,
    hits: tuple[wp.array, wp.array, wp.array] | None,
    launch: Any,
) -> None:
    """Signed distances, and closest points, faces and barycentric coordinates if `hits` has room for them.

    Args:
        tree: One mesh's hierarchy.
        winding: How its winding number is found.
        points: (N,) vec3; one that is not finite gives NaN and face -1.
        order: (N,) the order to go through them, or empty: as they come.
        groups: (ceil(N / GROUP),) int32, scratch: for each group a triangle near it, and two hints for the sign.
        values: (N,) float32, filled: negative inside.
        hits: Filled if given: (N,) vec3, (N,) int32, (N,) vec3.
        launch: `sdm.kernels.launch.launch`.
    """
    device = points.device
    if hits is None:
        none = wp.empty(0, dtype=wp.vec3, device=device)
        hits = (none, wp.empty(0, dtype=wp.int32, device=device), none)
        wanted = 0
    else:
        wanted = 1
    length = 1 if device.is_cuda else CPU_RUN
    runs = -(-points.shape[0] // length)
    lanes = GPU_LANES if device.is_cuda else 1
    launch(_look_around, groups.shape[0] * lanes, [lanes, tree, winding, points, order, groups], device)
    launch(_query, runs, [length, tree, winding, points, order, groups, values, wanted, *hits], device)


def query_winding(tree: Tree, winding: Winding, points: wp.array, values: wp.array, launch: Any) -> None:
    """The generalised winding number at each point, (N,) float32."""
    launch(_winding, points.shape[0], [tree, winding, points, values], points.device)
