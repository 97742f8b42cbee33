"""Closest points of scattered points, and the face that each is on."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_hit
from sdm.kernels.bvh.tree import FRAME_SIZE, UNSCALE, Tree, tree_of
from sdm.kernels.closest.facing import facing_slot
from sdm.kernels.closest.hits import Hits
from sdm.kernels.launch import launch
from sdm.kernels.points.packets import PACKET, Packets, mesh_of, numbered, scale_of

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _name_faces(
    begin: int,
    tree: Tree,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    hits: Hits,
):
    at = begin + wp.tid()
    i = numbered(order, at)
    if i < 0:
        return
    slot = hits.faces[i]
    if slot < 0:
        hits.points[i] = wp.vec3(wp.nan, wp.nan, wp.nan)
        hits.barycentric[i] = wp.vec3(wp.nan, wp.nan, wp.nan)
    else:
        mesh = mesh_of(packets, at / PACKET)
        p = scale_of(tree, mesh) * wp.vec3d(points[i])
        hit = exact_hit(tree, slot, p)
        best = facing_slot(tree_of(tree, mesh), slot, p, hit)
        if best != slot:
            hit = exact_hit(tree, best, p)
        hits.points[i] = wp.vec3(tree.frame[mesh * FRAME_SIZE + UNSCALE] * hit.point)
        hits.faces[i] = tree.face[best]
        hits.barycentric[i] = wp.vec3(hit.barycentric)


def name_faces(tree: Tree, points: wp.array, order: wp.array, packets: Packets, hits: Hits) -> None:
    """Fill `hits` for points (N,) from the slots that `hits.faces` holds, in their order or as they come."""
    launch(_name_faces, packets.places, [tree, points, order, packets, hits], points.device, smallest=512)
