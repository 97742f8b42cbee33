"""Queries at scattered points."""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.boundary import Boundary, boundary_winding
from sdm.kernels.closest import nearest_slot
from sdm.kernels.crossings import count_crossings
from sdm.kernels.curve import CURVE_BITS, curve_code
from sdm.kernels.geometry import closest_point
from sdm.kernels.solid_angle import soup_winding
from sdm.kernels.tree import FRAME_SIZE, SCALE, UNSCALE, Tree, node_box

wp.set_module_options({"enable_backward": False})

_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)
# Neighbours along the curve that one thread takes one after the other, each from the answer before it. A GPU would
# rather have more threads.
CPU_RUN = 8


@wp.struct
class Winding:
    """How the winding number is found: the kind of mesh decides."""

    boundary: Boundary  # used if kind is OPEN
    moments: wp.array(dtype=wp.float32)  # used if kind is SOUP
    kind: wp.int32


CLOSED, OPEN, SOUP = 0, 1, 2
_OPEN = wp.constant(OPEN)
_SOUP = wp.constant(SOUP)


@wp.func
def winding_at(tree: Tree, winding: Winding, mesh: int, p: wp.vec3d):
    """The generalised winding number at p (scaled)."""
    if winding.kind == _SOUP:
        return float(soup_winding(tree, winding.moments, mesh, p))
    result = wp.float64(count_crossings(tree, mesh, p))
    if winding.kind == _OPEN:
        result = result + boundary_winding(winding.boundary, tree, mesh, p)
    return float(result)


@wp.func
def is_finite(p: wp.vec3):
    return wp.isfinite(p[0]) and wp.isfinite(p[1]) and wp.isfinite(p[2])


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
def _query(
    begin: int,
    length: int,
    tree: Tree,
    winding: Winding,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    want_hits: int,
    hit_points: wp.array(dtype=wp.vec3),
    hit_faces: wp.array(dtype=wp.int32),
    hit_barycentric: wp.array(dtype=wp.vec3),
):
    run = begin + wp.tid()
    total = points.shape[0]
    guess = int(0)
    scale = tree.frame[_SCALE]
    unscale = tree.frame[_UNSCALE]
    # The bound is a variable so that Warp does not write the loop out.
    steps = int(length)
    for step in range(steps):
        at = run * steps + step
        if at < total:
            i = at
            if order.shape[0] > 0:
                i = order[at]
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
                if winding_at(tree, winding, 0, exact) > 0.5:
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
    launch(_query, runs, [length, tree, winding, points, order, values, wanted, *hits], device)


def query_winding(tree: Tree, winding: Winding, points: wp.array, values: wp.array, launch: Any) -> None:
    """The generalised winding number at each point, (N,) float32."""
    launch(_winding, points.shape[0], [tree, winding, points, values], points.device)
