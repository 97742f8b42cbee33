"""Queries at scattered points.

Points are sorted along a curve and taken in groups of neighbours, as a dense query takes voxels in blocks: what a group
has in common (`groups`) gives one list of triangles that may be nearest to any of its points (`nearest_points`), and
one of those that rays from them may meet (`point_signs`). Found along the tree by all lanes together (`gather`), both
are short. A search of the tree for each point by itself, which is what all this does faster, stays for groups whose
points are so far apart that their lists would be too long.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.cones import Cones
from sdm.kernels.curve import POINT_BITS, curve_code
from sdm.kernels.gather import SCRATCH
from sdm.kernels.groups import GROUP, Groups, is_finite, look_around
from sdm.kernels.lanes import GPU_LANES, GPU_WORKERS
from sdm.kernels.launch import threads
from sdm.kernels.nearest_points import Hits, find_nearest
from sdm.kernels.parts import Parts
from sdm.kernels.point_signs import find_sides
from sdm.kernels.tree import SCALE, Tree, node_box
from sdm.kernels.winding import Winding, winding_at

wp.set_module_options({"enable_backward": False})

_SCALE = wp.constant(SCALE)


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
    keys[i] = curve_code(p, 2.0 * low - middle, 2.0 * high - middle, POINT_BITS)
    order[i] = i


@wp.kernel
def _winding(
    begin: int, tree: Tree, winding: Winding, points: wp.array(dtype=wp.vec3), values: wp.array(dtype=wp.float32)
):
    i = begin + wp.tid()
    values[i] = float(wp.nan)
    if is_finite(points[i]):
        values[i] = winding_at(tree, winding, 0, tree.frame[_SCALE] * wp.vec3d(points[i]))


def sort_points(points: wp.array, tree: Tree, keys: wp.array, order: wp.array, launch: Any) -> None:
    """Fill `order` with the points' order along a curve through the tree's box.

    Args:
        points: (N,) vec3.
        tree: One mesh's hierarchy.
        keys: (2N,) int64, scratch.
        order: (2N,) int32, filled: the first N are the order.
        launch: `sdm.kernels.launch.launch`.
    """
    count = points.shape[0]
    launch(_point_keys, count, [points, tree, keys, order], points.device)
    wp.utils.radix_sort_pairs(keys, order, count, end_bit=3 * POINT_BITS)


def query_points(
    tree: Tree,
    parts: Parts,
    cones: Cones,
    winding: Winding,
    points: wp.array,
    order: wp.array,
    values: wp.array,
    hits: tuple[wp.array, wp.array, wp.array] | None,
    launch: Any,
    empty: Callable[[int, Any], wp.array],
    method: str = "auto",
) -> None:
    """Signed distances, and closest points, faces and barycentric coordinates if `hits` has room for them.

    Args:
        tree: One mesh's hierarchy.
        parts: Its triangles' balls.
        cones: Its cones of normals.
        winding: How its winding number is found.
        points: (N,) vec3; one that is not finite gives NaN and face -1.
        order: (N,) the order to go through them, or empty: as they come.
        values: (N,) float32, filled: negative inside.
        hits: Filled if given: (N,) vec3, (N,) int32, (N,) vec3.
        launch: `sdm.kernels.launch.launch`.
        empty: Allocates scratch: `empty(length, dtype)`.
        method: `"lists"` for the fast path, `"search"` for the plain one, `"auto"` for the one that is expected to be
            faster. Both are exact.
    """
    # One lane goes through a list slower than down the tree.
    lists = method == "lists" or (method == "auto" and points.device.is_cuda)
    lanes, workers = (GPU_LANES, GPU_WORKERS) if points.device.is_cuda else (1, 16 * threads())
    groups = Groups()
    groups.count = -(-points.shape[0] // GROUP)
    groups.boxes = empty(8 * groups.count, wp.float32)
    groups.witnesses = empty(4 * groups.count, wp.float32)
    groups.nearest = empty(groups.count, wp.int32)
    groups.hints = empty(groups.count, wp.int32)
    wanted = Hits()
    wanted.wanted = int(hits is not None)
    wanted.points, wanted.faces, wanted.barycentric = hits or (empty(0, wp.vec3), empty(0, wp.int32), empty(0, wp.vec3))
    next_groups = [empty(1, wp.int32), empty(1, wp.int32)]
    for count in next_groups:
        count.zero_()
    workers = min(workers, groups.count)
    scratch = empty(workers * SCRATCH, wp.int32)
    look_around(tree, winding, points, order, groups, lanes, launch)
    find_nearest(
        tree,
        parts.balls,
        cones,
        points,
        order,
        groups,
        next_groups[0],
        lists,
        scratch,
        values,
        wanted,
        workers,
        lanes,
        launch,
    )
    find_sides(tree, winding, points, order, groups, next_groups[1], lists, scratch, values, workers, lanes, launch)


def query_winding(tree: Tree, winding: Winding, points: wp.array, values: wp.array, launch: Any) -> None:
    """The generalised winding number at each point, (N,) float32."""
    launch(_winding, points.shape[0], [tree, winding, points, values], points.device)
