"""Closest points of a mesh with float64 vertices: on a face that float32 knows to be nearest, or beside it.

Only where an edge or a corner is nearest may a neighbour of that face be as near. Of faces that are equally near the
one is named whose front looks at the point most: with the largest cos of the angle between its normal and the way to
the point, the known face first where they are the same.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.triangle_distance import segment_parameter
from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

# Share of a corner below which a closest point may lie on the edge across from it; of slivers float32 knows no better.
ON_AN_EDGE = 1.0e-2
# Steps of cos that tell faces apart.
STEPS = wp.float64(1.0e9)
TINY = wp.float64(2.2250738585072014e-308)


@wp.struct
class ExactMesh:
    """Vertices and faces, and of each face's edges another face there."""

    vertices: wp.array(dtype=wp.vec3d)
    faces: wp.array2d(dtype=wp.int32)
    neighbours: wp.array2d(dtype=wp.int32)  # (F, 3 or more) as 3 * face + edge, or -1: see `topology.edge_pairing`
    equal: wp.float64  # squared distances that differ by no more than this share of themselves are equal,
    rounding: wp.float64  # or by no more than this


@wp.struct
class Known:
    """Answers of a query in float32 for each point."""

    values: wp.array(dtype=wp.float32)
    faces: wp.array(dtype=wp.int32)
    barycentric: wp.array(dtype=wp.vec3)


@wp.struct
class Answers:
    """Signed distances, closest points, faces and the faces' unit normals, which are zero without an area."""

    distances: wp.array(dtype=wp.float64)
    points: wp.array(dtype=wp.vec3d)
    faces: wp.array(dtype=wp.int64)
    normals: wp.array(dtype=wp.vec3d)


@wp.func
def near_on_segment(p: wp.vec3d, begin: wp.vec3d, end: wp.vec3d):
    """The point of a segment that is closest to p."""
    along = end - begin
    return begin + segment_parameter(p - begin, along) * along


@wp.func
def on_triangle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """The point of a triangle of any size that is closest to p.

    The foot on the plane where it is inside the triangle, else the nearest of the closest points of the three edges;
    triangles without an area are their edges.
    """
    best = near_on_segment(p, a, b)
    least = wp.length_sq(p - best)
    other = near_on_segment(p, b, c)
    if wp.length_sq(p - other) < least:
        best = other
        least = wp.length_sq(p - best)
    other = near_on_segment(p, c, a)
    if wp.length_sq(p - other) < least:
        best = other
        least = wp.length_sq(p - best)
    normal = wp.cross(b - a, c - a)
    size = wp.length_sq(normal)
    zero = wp.float64(0.0)
    if size > zero:
        foot = p - (wp.dot(p - a, normal) / wp.max(size, TINY)) * normal
        inside = wp.dot(wp.cross(b - a, foot - a), normal) >= zero
        inside = inside and wp.dot(wp.cross(c - b, foot - b), normal) >= zero
        inside = inside and wp.dot(wp.cross(a - c, foot - c), normal) >= zero
        # Beside a sliver the foot's own tests are noise: it counts if it is nearer.
        if inside and wp.length_sq(p - foot) <= least:
            best = foot
    return best


@wp.func
def near_on_face(mesh: ExactMesh, face: int, p: wp.vec3d):
    """The closest point of a face."""
    return on_triangle(
        p,
        mesh.vertices[mesh.faces[face, 0]],
        mesh.vertices[mesh.faces[face, 1]],
        mesh.vertices[mesh.faces[face, 2]],
    )


@wp.func
def normal_of(mesh: ExactMesh, face: int):
    """The unit normal of a face, zero without an area."""
    a = mesh.vertices[mesh.faces[face, 0]]
    normal = wp.cross(mesh.vertices[mesh.faces[face, 1]] - a, mesh.vertices[mesh.faces[face, 2]] - a)
    size = wp.length(normal)
    if size > wp.float64(0.0):
        normal = normal / size
    return normal


@wp.func
def front_of(mesh: ExactMesh, face: int, way: wp.vec3d):
    """cos of the angle between a face's normal and the way to a point, in whole steps."""
    length = wp.max(wp.length(way), TINY)
    return wp.rint(STEPS * wp.dot(normal_of(mesh, face), way) / length)


@wp.kernel
def _measure(
    begin: int,
    mesh: ExactMesh,
    points: wp.array(dtype=wp.vec3d),
    known: Known,
    answers: Answers,
):
    i = begin + wp.tid()
    p = points[i]
    if known.faces[i] < 0:
        p = wp.vec3d(wp.float64(wp.nan), wp.float64(wp.nan), wp.float64(wp.nan))
    own = wp.max(known.faces[i], 0)
    closest = near_on_face(mesh, own, p)
    squared = wp.length_sq(p - closest)
    named = int(own)
    if wp.min(known.barycentric[i]) <= ON_AN_EDGE:
        least = wp.float64(squared)
        others = wp.vec3d(wp.float64(wp.inf), wp.float64(wp.inf), wp.float64(wp.inf))
        places = wp.mat33d()
        for k in range(3):
            if mesh.neighbours[own, k] >= 0:
                places[k] = near_on_face(mesh, mesh.neighbours[own, k] / 3, p)
                others[k] = wp.length_sq(p - places[k])
                least = wp.min(least, others[k])
        # A point on the surface has no side: the nearest face is its own.
        reach = least
        if least > mesh.rounding:
            reach = (wp.float64(1.0) + mesh.equal) * least + mesh.rounding
        front = wp.float64(-wp.inf)
        if squared <= reach and wp.min(others) <= reach:
            front = front_of(mesh, own, p - closest)
        for k in range(3):
            if others[k] <= reach:
                face = mesh.neighbours[own, k] / 3
                looks = front_of(mesh, face, p - places[k])
                if looks > front:
                    front = looks
                    closest = places[k]
                    squared = others[k]
                    named = face
    distance = wp.sqrt(squared)
    answers.distances[i] = wp.where(known.values[i] < 0.0, -distance, distance)
    answers.points[i] = closest
    answers.faces[i] = wp.int64(named)
    answers.normals[i] = normal_of(mesh, named)


def measure_in_float64(mesh: ExactMesh, points: wp.array, known: Known, answers: Answers) -> None:
    """Fill `answers` for points (N,) vec3d; where `known` has no face, as of a point that is not finite, with NaN."""
    launch(_measure, points.shape[0], [mesh, points, known, answers], points.device, smallest=1024)
