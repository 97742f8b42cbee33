"""Signs of points of open meshes that differ, whose distances are there already.

As in a query about one mesh: what can be said about a packet by its mesh's holes, then by lists of triangles on the
rays from its points, then for single points (see `query`, `signs`). In kernels of their own, so that those of other
queries know nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.launch import launch
from sdm.kernels.points.edge_signs import lanes_and_parts, sign_part
from sdm.kernels.points.group_descent import SCRATCH
from sdm.kernels.points.open_meshes import EDGES, ROW, SIXTEENS, OpenMeshes, by_itself, winding_of
from sdm.kernels.points.packets import (
    COVERED,
    FAR,
    NEXT_SIDE,
    PACKET,
    POINT_BLOCKS_PER_SM,
    Packets,
    is_finite,
    mesh_of,
    numbered,
    read_box,
    scale_of,
)
from sdm.kernels.points.plan import PointsPlan
from sdm.kernels.points.query import workers_for
from sdm.kernels.points.signs import INSIDE, UNKNOWN, inside_by_rays, sides_of_packet
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, on_cpu
from sdm.kernels.winding.eights.packed_edges import ROW as EDGES_ROW
from sdm.kernels.winding.eights.packed_edges import pack_in_rows
from sdm.kernels.winding.hole_caps import is_far, may_cover, view_caps
from sdm.kernels.winding.winding_number import MANY, OPEN, inside_at

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _look_at_holes(begin: int, lanes: int, meshes: OpenMeshes, packets: Packets):
    """A group of lanes for each packet, to whose hints it adds."""
    thread = begin + wp.tid()
    lane = thread % lanes
    packet = thread / lanes
    box = read_box(packets, packet)
    winding = winding_of(meshes, mesh_of(packets, packet))
    if box.half2 < float(wp.inf) and (winding.kind == OPEN or winding.kind == MANY):
        if is_far(view_caps(winding.caps, winding.boundary, 0, box, lane, lanes)):
            hint = FAR + wp.where(may_cover(winding.caps, 0, box, lane, lanes), COVERED, 0)
            if lane == 0:
                packets.hints[packet] = packets.hints[packet] | hint


@wp.kernel(launch_bounds=(128, POINT_BLOCKS_PER_SM))
def _find_sides(
    begin: int,
    lanes: int,
    tree: Tree,
    meshes: OpenMeshes,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    scratch: wp.array(dtype=wp.int32),
    sides: wp.array(dtype=wp.int32),
):
    """As that of `signs`."""
    thread = begin + wp.tid()
    lane = thread % lanes
    room = (thread / lanes) * SCRATCH
    packet = fetch_add_once(packets.counts, NEXT_SIDE, 1, lane)
    while packet < packets.count:
        mesh = mesh_of(packets, packet)
        caps = winding_of(meshes, mesh).caps.tree
        sides_of_packet(tree, mesh, caps, points, order, packets, packet, scratch, room, sides, lane, lanes)
        packet = fetch_add_once(packets.counts, NEXT_SIDE, 1, lane)


@wp.kernel
def _pack_edges(begin: int, meshes: OpenMeshes, rows: wp.array(dtype=wp.float32), packed: wp.array(dtype=wp.int32)):
    """As `eights.packed_edges.pack_edges`, of each mesh whose edges are visited."""
    mesh = begin + wp.tid()
    packed[mesh] = 0
    if meshes.rows[ROW * mesh + EDGES] > 0:
        boundary = winding_of(meshes, mesh).boundary
        packed[mesh] = pack_in_rows(boundary, 0, meshes.rows[ROW * mesh + SIXTEENS], rows)


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def _sign_by_edges(
    begin: int,
    lanes: int,
    parts: int,
    tree: Tree,
    meshes: OpenMeshes,
    rows: wp.array(dtype=wp.float32),
    packed: wp.array(dtype=wp.int32),
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    sides: wp.array(dtype=wp.int32),
):
    """As that of `edge_signs`, where a mesh's edges are visited."""
    thread = begin + wp.tid()
    group = thread / lanes
    packet = group / parts
    mesh = mesh_of(packets, packet)
    row = ROW * mesh
    if (packets.hints[packet] & FAR) != 0 or meshes.rows[row + EDGES] == 0:
        return
    count = int(0)
    if packed.shape[0] > 0:
        count = packed[mesh]
    sign_part(
        by_itself(tree, mesh), winding_of(meshes, mesh).boundary, rows, meshes.rows[row + SIXTEENS], count, points,
        order, packets, packet, group - packet * parts, parts, sides, thread % lanes, lanes,
    )  # fmt: skip


@wp.kernel
def _write_signs(
    begin: int,
    length: int,
    tree: Tree,
    meshes: OpenMeshes,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    sides: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
):
    """Turn the distances of points that are inside; those whose side no list has told have their own winding number."""
    run = begin + wp.tid()
    # As in a query about one mesh: the point before, if its side goes for all of a ball, and its distance.
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
        there = i >= 0
        if there:
            there = is_finite(points[i])
        if there:
            side = UNKNOWN
            if sides.shape[0] > 0:
                side = sides[at]
            inside = side == INSIDE
            if side == UNKNOWN:
                mesh = mesh_of(packets, at / PACKET)
                one = by_itself(tree, mesh)
                scale = scale_of(tree, mesh)
                p = scale * wp.vec3d(points[i])
                hint = packets.hints[at / PACKET]
                if (hint & FAR) != 0 and (hint & COVERED) == 0:
                    radius = scale * wp.float64(values[i])
                    inside = inside_by_rays(one, 0, p, radius, before, reach, before_inside)
                    if on_cpu():
                        before = p
                        reach = radius
                        before_inside = inside
                else:
                    inside = inside_at(one, winding_of(meshes, mesh), p, (hint & FAR) != 0, (hint & COVERED) != 0)
            if inside:
                values[i] = -values[i]


def sign_points(
    tree: Tree,
    meshes: OpenMeshes,
    points: wp.array,
    order: wp.array,
    packets: Packets,
    values: wp.array,
    empty: Callable[[int, Any], wp.array],
    plan: PointsPlan,
    sixteens: int,
) -> None:
    """Give points of open meshes that differ their signs.

    Args:
        tree: The hierarchy of all meshes.
        meshes: Their winding data.
        points: (N,) vec3.
        order: (packets * PACKET,) of each packet the points of one mesh, and -1 for places without one.
        packets: Those of `query_points`, which has found the distances without signs.
        values: (N,) float32, the distances, to be made negative inside.
        empty: Allocates workspace: `empty(length, dtype)`.
        plan: That of the query.
        sixteens: Rows of sixteen edges for all meshes whose edges are visited.
    """
    count, device = packets.places, points.device
    lanes, parts = lanes_and_parts(packets.count, device.is_cuda)
    launch(_look_at_holes, packets.count * lanes, [lanes, meshes, packets], device, smallest=16)
    sides = empty(count if plan.lists or sixteens else 0, wp.int32)
    if plan.lists:
        workers = workers_for(packets, plan, device)
        scratch = empty(workers * SCRATCH, wp.int32)
        inputs = [lanes, tree, meshes, points, order, packets, scratch, sides]
        launch(_find_sides, workers * lanes, inputs, device, smallest=1)
    elif sixteens:
        # All are unknown.
        sides.zero_()
    if sixteens:
        all_meshes = meshes.rows.shape[0] // ROW
        sixteens = 0 if device.is_cuda else sixteens
        rows, packed = empty(EDGES_ROW * sixteens, wp.float32), empty(all_meshes if sixteens else 0, wp.int32)
        if sixteens:
            launch(_pack_edges, all_meshes, [meshes, rows, packed], device, smallest=1)
        inputs = [lanes, parts, tree, meshes, rows, packed, points, order, packets, sides]
        launch(_sign_by_edges, packets.count * parts * lanes, inputs, device, smallest=1)
    inputs = [plan.run, tree, meshes, points, order, packets, sides, values]
    launch(_write_signs, -(-count // plan.run), inputs, device, smallest=16)
