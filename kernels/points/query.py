"""Queries at scattered points.

The plain path (`_query`) is a search of the tree and a winding number for each point. Points are sorted along a curve
first and taken in packets of neighbours (`packets`), each of which begins with the triangle nearest to its middle.

The fast path finds both answers for whole packets before, as a dense query does for blocks of voxels: one list of
triangles that may be nearest to any of a packet's points (`nearest`), and one of those that rays from them may meet
(`signs`), gathered from the tree by all lanes together (`candidates`). The plain path is then left with packets so wide
that their lists are too long. Near an open mesh's holes all lanes share its boundary edges (`edge_signs`), unless these
are too many.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_hit, nearest_slot
from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, UNSCALE, Tree, node_box, nodes_of, tree_of
from sdm.kernels.closest.hits import Hits
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.geometry.hilbert import POINT_BITS, curve_code
from sdm.kernels.launch import CURVE_SHARE, launch, threads
from sdm.kernels.points.closest import name_faces
from sdm.kernels.points.edge_signs import is_summed, sign_by_edges
from sdm.kernels.points.group_descent import SCRATCH
from sdm.kernels.points.nearest import find_nearest
from sdm.kernels.points.packets import (
    COUNTS,
    COVERED,
    FAR,
    PACKET,
    POINT_BLOCKS_PER_SM,
    Packets,
    is_finite,
    look_around,
    mesh_of,
    numbered,
    scale_of,
)
from sdm.kernels.points.plan import PointsPlan
from sdm.kernels.points.signs import INSIDE, OUTSIDE, UNKNOWN, find_sides, inside_by_rays
from sdm.kernels.primitives.lanes import GPU_LANES, gpu_workers, on_cpu
from sdm.kernels.winding.winding_number import UNSIGNED, Winding, inside_at, winding_at

wp.set_module_options({"enable_backward": False})

# Packets to look around that are worth a turn of a CPU's thread: some microseconds each.
PACKETS_OF_THREAD = 32
# Of a point's place along the curve; the number of its mesh is above.
_CODE_BITS = 3 * POINT_BITS


@wp.kernel
def _point_keys(
    begin: int,
    points: wp.array(dtype=wp.vec3),
    owners: wp.array(dtype=wp.int32),
    tree: Tree,
    corner: wp.vec3,
    edge: float,
    keys: wp.array(dtype=wp.int64),
    order: wp.array(dtype=wp.int32),
):
    i = begin + wp.tid()
    if edge > 0.0:
        keys[i] = curve_code(points[i], corner, corner + wp.vec3(edge, edge, edge), POINT_BITS)
    else:
        mesh = int(0)
        if owners.shape[0] > 0:
            mesh = owners[i]
        p = float(scale_of(tree, mesh)) * points[i]
        # Twice the mesh's box: most points that people ask for are inside it.
        low, high = node_box(tree, nodes_of(tree_of(tree, mesh), mesh) + 1)
        middle = 0.5 * (low + high)
        code = curve_code(p, 2.0 * low - middle, 2.0 * high - middle, POINT_BITS)
        keys[i] = code | (wp.int64(mesh) << wp.int64(_CODE_BITS))
    order[i] = i


@wp.kernel
def _spread(begin: int, order: wp.array(dtype=wp.int32), count: int, share: int, places: wp.array(dtype=wp.int32)):
    """Give each packet so many of the points, and no others."""
    at = begin + wp.tid()
    packet = at / PACKET
    k = at - PACKET * packet
    number = packet * share + k
    i = int(-1)
    if k < share and number < count:
        i = numbered(order, number)
    places[at] = i


@wp.func
def answer(
    tree: Tree,
    mesh: int,
    slot: int,
    distance2: wp.float64,
    inside: bool,
    i: int,
    values: wp.array(dtype=wp.float32),
    hits: Hits,
):
    """Write what is asked of point i, whose nearest triangle is in a slot, at a distance (scaled)."""
    distance = float(wp.sqrt(distance2) * tree.frame[mesh * FRAME_SIZE + UNSCALE])
    values[i] = wp.where(inside, -distance, distance)
    if hits.wanted != 0:
        # For `name_faces`.
        hits.faces[i] = slot


@wp.kernel
def _finish(
    begin: int,
    tree: Tree,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    slots: wp.array(dtype=wp.int32),
    sides: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    hits: Hits,
):
    at = begin + wp.tid()
    i = numbered(order, at)
    if i < 0:
        return
    # Without a sign there are no sides.
    side = OUTSIDE
    if sides.shape[0] > 0:
        side = sides[at]
    if slots[at] >= 0 and side != UNKNOWN and is_finite(points[i]):
        mesh = mesh_of(packets, at / PACKET)
        hit = exact_hit(tree, slots[at], scale_of(tree, mesh) * wp.vec3d(points[i]))
        answer(tree, mesh, slots[at], hit.distance2, side == INSIDE, i, values, hits)


@wp.kernel
def _query(
    begin: int,
    length: int,
    tree: Tree,
    winding: Winding,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    slots: wp.array(dtype=wp.int32),
    sides: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    hits: Hits,
):
    run = begin + wp.tid()
    guess = int(-1)
    # The point before, if its side goes for all of a ball, and its distance.
    before = wp.vec3d()
    reach = wp.float64(-wp.inf)
    before_inside = bool(False)
    # The bound is a variable so that Warp does not write the loop out.
    steps = int(length)
    for step in range(steps):
        at = run * steps + step
        i = int(-1)
        if at < packets.places:
            i = numbered(order, at)
        if i >= 0:
            point = points[i]
            slot = int(-1)
            side = UNKNOWN
            if slots.shape[0] > 0:
                slot = slots[at]
            if winding.kind == UNSIGNED:
                side = OUTSIDE
            elif sides.shape[0] > 0:
                side = sides[at]
            if not is_finite(point):
                values[i] = float(wp.nan)
                if hits.wanted != 0:
                    hits.faces[i] = -1
            elif slot < 0 or side == UNKNOWN:
                mesh = mesh_of(packets, at / PACKET)
                scale = scale_of(tree, mesh)
                if slot < 0:
                    if guess < 0:
                        guess = packets.nearest[at / PACKET]
                    slot = nearest_slot(tree_of(tree, mesh), mesh, float(scale) * point, guess)
                    guess = slot
                p = scale * wp.vec3d(point)
                distance2 = exact_hit(tree, slot, p).distance2
                inside = side == INSIDE
                if side == UNKNOWN:
                    hint = packets.hints[at / PACKET]
                    if (hint & FAR) != 0 and (hint & COVERED) == 0:
                        radius = wp.sqrt(distance2)
                        inside = inside_by_rays(tree_of(tree, mesh), mesh, p, radius, before, reach, before_inside)
                        if on_cpu():
                            before = p
                            reach = radius
                            before_inside = inside
                    else:
                        # There is one mesh, as of many each is taken for closed.
                        inside = inside_at(tree, winding, p, (hint & FAR) != 0, (hint & COVERED) != 0)
                answer(tree, mesh, slot, distance2, inside, i, values, hits)


@wp.kernel
def _winding(
    begin: int, tree: Tree, winding: Winding, points: wp.array(dtype=wp.vec3), values: wp.array(dtype=wp.float32)
):
    i = begin + wp.tid()
    values[i] = float(wp.nan)
    if is_finite(points[i]):
        values[i] = winding_at(tree, winding, 0, tree.frame[SCALE] * wp.vec3d(points[i]))


def sort_points(
    points: wp.array,
    owners: wp.array,
    tree: Tree,
    keys: wp.array,
    order: wp.array,
    cube: Sequence[float] | None = None,
) -> None:
    """Fill `order` with the points' order along a curve through the tree's box, or through a cube.

    Args:
        points: (N,) vec3.
        owners: (N,) where meshes differ, that of each point: points of a mesh follow each other. Else empty.
        tree: One mesh's hierarchy, or that of meshes that differ.
        keys: (2N,) int64, workspace.
        order: (2N,) int32, filled: the first N are the order.
        cube: The least x, y and z, and the edge. The curve takes each eighth of it as a whole, each eighth of that, ...
    """
    count = points.shape[0]
    *corner, edge = cube or (0.0, 0.0, 0.0, 0.0)
    launch(
        _point_keys,
        count,
        [points, owners, tree, wp.vec3(*corner), edge, keys, order],
        points.device,
        smallest=CURVE_SHARE,
    )
    wp.utils.radix_sort_pairs(keys, order, count, end_bit=_CODE_BITS + int(tree.meshes).bit_length())


def query_points(
    tree: Tree,
    features: Features,
    cones: Cones,
    winding: Winding,
    points: wp.array,
    order: wp.array,
    values: wp.array,
    hits: tuple[wp.array, wp.array, wp.array] | None,
    empty: Callable[[int, Any], wp.array],
    plan: PointsPlan,
    meshes: wp.array | None = None,
) -> Packets:
    """Signed distances, and closest points, faces and barycentric coordinates if `hits` has room for them.

    Args:
        tree: One mesh's hierarchy, or that of meshes that differ.
        features: Its triangles' balls.
        cones: Its cones of normals.
        winding: How its winding number is found; of the kind `UNSIGNED` all points are taken for outside. Meshes that
            differ are taken for closed.
        points: (N,) vec3; one that is not finite gives NaN and face -1.
        order: (N,) the order to go through them, or empty: as they come. Where meshes differ (packets * PACKET,): of
            each packet the points of one mesh, and -1 for places without one.
        values: (N,) float32, filled: negative inside.
        hits: Filled if given: (N,) vec3, (N,) int32, (N,) vec3.
        empty: Allocates workspace: `empty(length, dtype)`.
        plan: Decisions about the query; distances are exact whatever they are.
        meshes: (packets,) where meshes differ, that of each packet.

    Returns:
        The packets, in memory of `empty`.
    """
    count, device = points.shape[0] if meshes is None else order.shape[0], points.device
    lanes = GPU_LANES if device.is_cuda else 1
    if plan.share < PACKET:
        order, by = empty(PACKET * plan.packets, wp.int32), order
        launch(_spread, order.shape[0], [by, count, plan.share, order], device)
        count = order.shape[0]
    packets = Packets()
    packets.count, packets.places = plan.packets, count
    packets.meshes = empty(0, wp.int32) if meshes is None else meshes
    packets.boxes = empty(8 * packets.count, wp.float32)
    packets.witnesses = empty(4 * packets.count, wp.float32)
    packets.nearest = empty(packets.count, wp.int32)
    packets.hints = empty(packets.count, wp.int32)
    workers = workers_for(packets, plan, device)
    scratch = empty(workers * SCRATCH, wp.int32)
    packets.counts = empty(COUNTS, wp.int32)
    packets.counts.zero_()
    look_around(tree, winding, points, order, packets, scratch, workers, lanes)
    slots = empty(count if plan.lists else 0, wp.int32)
    signed = winding.kind != UNSIGNED
    by_edges = signed and meshes is None and is_summed(winding.kind, winding.boundary.count, device.is_cuda)
    sides = empty(count if signed and (plan.lists or by_edges) else 0, wp.int32)
    wanted = Hits()
    wanted.wanted = int(hits is not None)
    wanted.points, wanted.faces, wanted.barycentric = hits or (empty(0, wp.vec3), empty(0, wp.int32), empty(0, wp.vec3))
    if plan.lists:
        find_nearest(tree, features.balls, cones, points, order, packets, scratch, slots, workers, lanes)
        if signed:
            find_sides(tree, winding, points, order, packets, scratch, sides, workers, lanes)
    elif by_edges:
        # All are unknown.
        sides.zero_()
    if by_edges:
        sign_by_edges(tree, winding.boundary, points, order, packets, sides, empty)
    if plan.lists:
        launch(_finish, count, [tree, points, order, packets, slots, sides, values, wanted], device)
    inputs = [plan.run, tree, winding, points, order, packets, slots, sides, values, wanted]
    launch(_query, -(-count // plan.run), inputs, device, smallest=16)
    if hits is not None:
        name_faces(tree, points, order, packets, wanted)
    return packets


def workers_for(packets: Packets, plan: PointsPlan, device: Any) -> int:
    """Groups of lanes that take packets one after the other."""
    workers = gpu_workers(device, POINT_BLOCKS_PER_SM) if device.is_cuda else 2 * threads()
    return min(workers, packets.count if device.is_cuda or plan.lists else -(-packets.count // PACKETS_OF_THREAD))


def query_winding(tree: Tree, winding: Winding, points: wp.array, values: wp.array) -> None:
    """The generalised winding number at each point, (N,) float32."""
    launch(_winding, points.shape[0], [tree, winding, points, values], points.device)
