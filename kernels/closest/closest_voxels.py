"""Closest points of a map's voxels, from the feature that each voxel's distance is from.

A map knows for each voxel which corner, edge or face its distance was measured to (`dense.block.winners`), so nothing
is searched for again: the closest point is worked out on that feature in float64. One of the faces there is named by
the rule of `facing`, in float32: of an edge among all its faces, and of a corner among those that one comes to by going
from face to face around it: to one side, and from a border to the other. What takes the rule further for points, other
triangles that only touch there, is not looked for. Where a search found the triangle the rule is that of points, to the
letter.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_hit
from sdm.kernels.bvh.tree import SCALE, UNSCALE, Tree, load_corners
from sdm.kernels.closest.facing import facing_slot
from sdm.kernels.closest.hits import Hits
from sdm.kernels.geometry.triangle_distance import segment_parameter
from sdm.kernels.geometry.voxel_grid import SEARCHED, Slab, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_LANES, gpu_workers
from sdm.kernels.primitives.vector_loads import load4, load_row, write4

wp.set_module_options({"enable_backward": False})

# Faces that are gone to around a corner, or at an edge, in each direction.
MOST_AROUND = 64
# As in `facing`: room in "faces as much"; nearer than this, scaled, a query point is on the surface.
SAME = 1.0e-6
ON_SURFACE = 2.0**-24


@wp.struct
class Surroundings:
    """Faces that meet, and their normals: what a face is compared by with those around."""

    # (F, 4) of each edge the next face there, as 2 * (3 * face + edge) and 1 more if the edge leads the same way there,
    # or -1.
    rows: wp.array2d(dtype=wp.int32)
    normals: wp.array(dtype=wp.float32)  # (4 * F) unit normals, or zero of faces that are nearly segments


@wp.struct
class Named:
    """The face that is named so far, and the two largest |cos| of all: the other one may be the same again."""

    place: wp.int32  # 3 * face + corner, where the edge begins or the corner is
    back: wp.int32  # 1 if the edge leads the other way there
    most: float
    second: float


@wp.kernel
def _look_around(
    begin: int,
    tree: Tree,
    faces: wp.array2d(dtype=wp.int32),
    neighbours: wp.array2d(dtype=wp.int32),
    around: Surroundings,
):
    slot = begin + wp.tid()
    face = tree.face[slot]
    _a, _b, _c, n = load_corners(tree, slot)
    write4(around.normals, face, n[0], n[1], n[2], 0.0)
    row = load_row(neighbours, face)
    for k in range(3):
        code = int(-1)
        if row[k] >= 0:
            code = 2 * row[k]
            if faces[row[k] / 3, row[k] % 3] == faces[face, k]:
                code = code + 1
        around.rows[face, k] = code


def look_around(tree: Tree, faces: wp.array, neighbours: wp.array, around: Surroundings) -> None:
    """Fill `around` for a mesh's faces (F,3) from their neighbours (F,4), see `topology.edge_pairing`."""
    launch(_look_around, faces.shape[0], [tree, faces, neighbours, around], faces.device)


@wp.func
def better(around: Surroundings, way: wp.vec3, named: Named, place: int, back: int, again: bool):
    """The face that is named once another one was looked at: the largest |cos|, and `again` the smallest face.

    As `facing` has it: of those whose |cos| is as large as the largest of all, in whichever order they come.
    """
    face = place / 3
    n = load4(around.normals, face)
    cos = wp.abs(n[0] * way[0] + n[1] * way[1] + n[2] * way[2])
    found = named
    wins = cos > named.most
    if again:
        wins = cos >= named.most - SAME and face < named.place / 3
    else:
        found.second = wp.max(named.second, wp.min(named.most, cos))
        found.most = wp.max(named.most, cos)
    found.place = wp.where(wins, place, named.place)
    found.back = wp.where(wins, back, named.back)
    return found


@wp.func
def at_edge(around: Surroundings, way: wp.vec3, start: int, first: Named, again: bool):
    """The face to name at an edge, from a look at all faces there but the one to start from."""
    named = first
    code = around.rows[start / 3, start % 3]
    back = int(0)
    steps = int(0)
    while code >= 0 and code / 2 != start and steps < MOST_AROUND:
        other = code / 2
        back = wp.where(code % 2 == 1, back, 1 - back)
        named = better(around, way, named, other, back, again)
        code = around.rows[other / 3, other % 3]
        steps = steps + 1
    return named


@wp.func
def around_corner(around: Surroundings, way: wp.vec3, place: int, first: Named, again: bool):
    """The face to name at a corner, from a look at all faces that are come to but the one to start from."""
    named = first
    start = place / 3
    corner = place % 3
    turn = int(0)
    while turn < 2:
        # Over the edge that begins at the corner, or over the one that ends there.
        code = around.rows[start, (corner + 2 * turn) % 3]
        begins = int(1 - turn)
        steps = int(0)
        while code >= 0 and code / 6 != start and steps < MOST_AROUND:
            other = code / 2
            side = other % 3
            begins = wp.where(code % 2 == 1, begins, 1 - begins)
            here = wp.where(begins == 1, side, (side + 1) % 3)
            leave = wp.where(begins == 1, (side + 2) % 3, here)
            named = better(around, way, named, other - side + here, 0, again)
            code = around.rows[other / 3, leave]
            begins = 1 - begins
            steps = steps + 1
        # All the way round, or from the border to the other side.
        turn = wp.where(code >= 0, 2, turn + 1)
    return named


@wp.func
def corner_of(k: int, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """The corner of number k, in float64."""
    return wp.vec3d(wp.where(k == 0, a, wp.where(k == 1, b, c)))


@wp.func
def weights_at(corner: int, at_corner: float, at_next: float):
    """Barycentric coordinates that are zero but for those of a corner and of the next."""
    return wp.vec3(
        wp.where(corner == 0, at_corner, wp.where(corner == 2, at_next, 0.0)),
        wp.where(corner == 1, at_corner, wp.where(corner == 0, at_next, 0.0)),
        wp.where(corner == 2, at_corner, wp.where(corner == 1, at_next, 0.0)),
    )


@wp.func
def weights_above(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Barycentric coordinates of the point of a triangle that p projects to, not less than zero.

    It projects inside by a float32 test, which a rounding may have passed.
    """
    zero = wp.float64(0.0)
    ab = b - a
    ca = a - c
    n = wp.cross(ca, ab)
    pa = p - a
    weights = wp.vec3d(
        wp.max(wp.dot(n, wp.cross(c - b, p - b)), zero),
        wp.max(wp.dot(n, wp.cross(ca, pa)), zero),
        wp.max(wp.dot(n, wp.cross(ab, pa)), zero),
    )
    return weights / (weights[0] + weights[1] + weights[2])


@wp.kernel
def _name_measured(begin: int, tree: Tree, slab: Slab, around: Surroundings, hits: Hits):
    number = begin + wp.tid()
    winner = hits.faces[number]
    if winner < 0:
        hits.faces[number] = -1 - winner
        return
    slot = winner / 8
    part = winner % 8
    a, b, c, _n = load_corners(tree, slot)
    face = tree.face[slot]
    _mesh, at = unravel(number, slab.shape)
    p = tree.frame[SCALE] * wp.vec3d(voxel(slab, at[0], at[1], at[2]))
    point = wp.vec3d()
    weights = wp.vec3()
    if part == 6:
        exact = weights_above(p, wp.vec3d(a), wp.vec3d(b), wp.vec3d(c))
        point = exact[0] * wp.vec3d(a) + exact[1] * wp.vec3d(b) + exact[2] * wp.vec3d(c)
        weights = wp.vec3(exact)
    else:
        corner = part % 3
        point = corner_of(corner, a, b, c)
        along = wp.float64(0.0)
        if part >= 3:
            edge = corner_of((corner + 1) % 3, a, b, c) - point
            along = segment_parameter(p - point, edge)
            point = point + along * edge
        way = wp.vec3(p - point)
        length = wp.length(way)
        far = wp.max(wp.abs(float(p[0])), wp.max(wp.abs(float(p[1])), wp.abs(float(p[2]))))
        way = wp.where(length > ON_SURFACE * wp.max(1.0, far), way / length, wp.vec3())
        start = 3 * face + corner
        named = Named()
        named.most = float(-1.0)
        named.second = float(-1.0)
        turn = int(0)
        while turn < 2:
            # Once more only where another one faces as much.
            named = better(around, way, named, start, 0, turn == 1)
            if part >= 3:
                named = at_edge(around, way, start, named, turn == 1)
            else:
                named = around_corner(around, way, start, named, turn == 1)
            turn = wp.where(named.second < named.most - SAME, 2, turn + 1)
        face = named.place / 3
        if named.back != 0:
            along = wp.float64(1.0) - along
        weights = weights_at(named.place % 3, float(wp.float64(1.0) - along), float(along))
    hits.points[number] = wp.vec3(tree.frame[UNSCALE] * point)
    hits.faces[number] = face
    hits.barycentric[number] = weights


@wp.kernel
def _name_searched(begin: int, step: int, searched: wp.array(dtype=wp.int32), tree: Tree, slab: Slab, hits: Hits):
    number = begin + wp.tid()
    if searched[0] == 0:
        return
    while number < hits.faces.shape[0]:
        winner = hits.faces[number]
        if winner % 8 == SEARCHED:
            _mesh, at = unravel(number, slab.shape)
            p = tree.frame[SCALE] * wp.vec3d(voxel(slab, at[0], at[1], at[2]))
            hit = exact_hit(tree, winner / 8, p)
            slot = facing_slot(tree, winner / 8, p, hit)
            if slot != winner / 8:
                hit = exact_hit(tree, slot, p)
            hits.points[number] = wp.vec3(tree.frame[UNSCALE] * hit.point)
            hits.barycentric[number] = wp.vec3(hit.barycentric)
            # Told apart from winners, until these are done.
            hits.faces[number] = -1 - tree.face[slot]
        number = number + step


def name_voxels(tree: Tree, slab: Slab, around: Surroundings, hits: Hits, searched: wp.array) -> None:
    """Fill `hits` for the voxels of one mesh's slab from their winners, which `hits.faces` holds.

    Args:
        tree: The mesh's hierarchy.
        slab: The voxels.
        around: As `look_around` fills it.
        hits: Filled.
        searched: (1,) zero if no winner is a searched triangle.
    """
    device = hits.faces.device
    workers = gpu_workers(device, BLOCKS_PER_SM) * GPU_LANES if device.is_cuda else 16 * threads()
    launch(_name_searched, workers, [workers, searched, tree, slab, hits], device, smallest=1)
    launch(_name_measured, hits.faces.shape[0], [tree, slab, around, hits], device)
