"""Sharp edges of a mesh that a dual surface cuts off: points of them become vertices of it.

A cell has one vertex for each piece of the surface in it. Where two edges of the mesh go through one cell, as at a step
of less than a voxel, one of them is cut off, by up to half a voxel, and no place of that vertex mends it. So points
along the mesh's edges are measured, and of those that are too far from the surface the furthest is put into the
triangle that is nearest to it, or into its edge, in turns, until none is left. Triangles and edges are divided, so what
is a closed manifold stays one.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.engine.mesh_index import MeshIndex
from sdm.topology.face_pairing import neighbours

# Cosine of the angle between two faces from which on their edge is sharp: a hundredth of a degree less than 30, so that
# none of 30 is missed by rounding.
SHARP = 0.8661
# In voxels: points of an edge are so far apart, and each ends so near to the surface. Half the one and the other are
# less than 0.05, within which all of the edge is.
APART, NEAR = 0.028, 0.035
# What is further away belongs to another part of the mesh, as outside of the grid.
FAR = 1.0
# Points at a time: of meshes with longer edges in all they are further apart.
MOST_POINTS = 1 << 23
# Rings of triangles around what is divided that are looked at, and those of them whose points are measured again.
RINGS, INNER_RINGS = 6, 4
# Nefertiti takes 27 at 128^3, 66 at 1024^3.
ROUNDS = 120
# Nearer to an edge than so much of a triangle's height a point divides the edge.
SNAP = 0.1
# Of a square voxel: no triangle becomes smaller.
LEAST_AREA = 1e-6
MOST_AT_ENDS = 256
# Of more points only the furthest of each triangle is looked at.
MANY = 1 << 12
# In voxels, beside a point of an edge: where one side is inside and one is not.
ASIDE = 1e-2


class EdgePoints(NamedTuple):
    """Points (N,3) of sharp edges, and the way (N,3) midway between the normals of the two faces there."""

    points: Tensor
    ways: Tensor


def with_sharp_edges(surface: TriangleMesh, index: MeshIndex, step: float) -> TriangleMesh:
    """A dual surface at level 0 with points of the mesh's sharp edges as vertices wherever it cuts them off.

    Args:
        surface: By the normals of the mesh.
        index: Of the mesh.
        step: Edge of a voxel.
    """
    points, ways = edge_points(index.mesh, APART * step)
    if not len(points):
        return surface
    distance, faces = _from(surface, points)
    cut_off = (distance > NEAR * step) & (distance < FAR * step)
    cut_off[cut_off.clone()] = _at_the_surface(index, points[cut_off], ways[cut_off], ASIDE * step)
    if not bool(cut_off.any()):
        return surface
    marked = torch.zeros(len(surface.vertices), dtype=torch.bool, device=surface.device)
    corners = surface.faces.long()
    marked[corners[faces[cut_off]]] = True
    part = inner = marked[corners].any(1)
    for ring in range(RINGS):
        part = marked[corners].any(1)
        marked[corners[part]] = True
        inner = part if ring < INNER_RINGS else inner
    asked = inner[faces] & (distance < FAR * step)
    asked[asked.clone()] = _at_the_surface(index, points[asked], ways[asked], ASIDE * step)
    used, local = torch.unique(corners[part], return_inverse=True)
    piece = TriangleMesh(surface.vertices[used], local.int(), check=False)
    divided = _divided(piece, points[asked], step)
    # Vertices of the piece that were there before are the surface's own; new ones follow all of them.
    places = torch.arange(len(divided.vertices), device=used.device) - len(used) + len(surface.vertices)
    places[: len(used)] = used
    vertices = torch.cat([surface.vertices, divided.vertices[len(used) :]])
    return TriangleMesh(
        vertices, torch.cat([corners[~part], places[divided.faces.long()]]).int(), surface.name, check=False
    )


def edge_points(mesh: TriangleMesh, apart: float) -> EdgePoints:
    """Points of a mesh's sharp edges, at most a length apart: of edges that two faces share by their indices.

    Each point of such an edge is within half that length of one.
    """
    vertices, faces = mesh.vertices.detach().double(), mesh.faces.long()
    around = neighbours(mesh.faces, len(vertices))[:, :3].long()
    own = torch.arange(len(faces), device=faces.device)[:, None]
    face, edge = (around // 3 > own).nonzero(as_tuple=True)
    other = around[face, edge]
    a, b, c = vertices[faces].unbind(1)
    normals = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=0.0)
    start, end = faces[face, edge], faces[face, (edge + 1) % 3]
    # Of a neighbour that faces the other way the normal is turned.
    turned = faces[other // 3, other % 3] == start
    one, two = normals[face], torch.where(turned[:, None], -normals[other // 3], normals[other // 3])
    sharp = ((one * two).sum(1) < SHARP) & (one != 0).any(1) & (two != 0).any(1)
    begin, along = vertices[start[sharp]], (vertices[end] - vertices[start])[sharp]
    lengths = along.norm(dim=1)
    apart = max(apart, float(lengths.sum()) / MOST_POINTS)
    counts = (lengths / apart).ceil().long()
    which = torch.repeat_interleave(counts)
    number = torch.arange(len(which), device=which.device) - (counts.cumsum(0) - counts)[which]
    # Not at the ends, where more than two faces are around.
    share = (number + 0.5) / counts[which]
    ways = torch.nn.functional.normalize(one + two, dim=1)[sharp]
    return EdgePoints((begin[which] + share[:, None] * along[which]).float(), ways[which])


def _from(surface: TriangleMesh, points: Tensor) -> tuple[Tensor, Tensor]:
    """Distances (N,) of points from a surface, and the nearest faces (N,)."""
    index = MeshIndex(surface, surface.device, warn=False)
    distance, hit = index.signed_distance(points, sign="none", return_closest=True)
    return distance, hit.faces.long()


def _at_the_surface(index: MeshIndex, points: Tensor, ways: Tensor, aside: float) -> Tensor:
    """Marks (N,) of points beside which both inside and outside are: others are of edges that are hidden inside."""
    if not len(points):
        return torch.zeros(0, dtype=torch.bool, device=points.device)
    sides = [index.winding_number((points.double() + way * aside * ways).float()) > 0.5 for way in (1, -1)]
    return sides[0] != sides[1]


def _divided(piece: TriangleMesh, points: Tensor, step: float) -> TriangleMesh:
    """A piece of a surface, with those of points (N,3) as vertices that are too far from it."""
    asked = points
    for _ in range(ROUNDS):
        distance, hit = MeshIndex(piece, piece.device, warn=False).signed_distance(
            asked, sign="none", return_closest=True
        )
        left = (distance > NEAR * step).nonzero()[:, 0]
        if len(left):
            # The furthest first.
            left = left[torch.argsort(distance[left], descending=True, stable=True)]
            first = _first_of_each(hit.faces[left].long(), len(piece)) if len(left) > MANY else slice(None)
            chosen = left[first]
            divided = _with_points(piece, asked[chosen], hit.faces[chosen].long(), hit.barycentric[chosen], step)
            if divided is not None:
                piece, asked = divided, asked[left]
                continue
        # Triangles beside those that were divided may have come further away from points that were near.
        if len(asked) == len(points):
            break
        asked = points
    return piece


def _first_of_each(face: Tensor, faces: int) -> Tensor:
    """The numbers of the first entry of each face among faces (N,), in their order."""
    own = torch.arange(len(face), device=face.device)
    first = torch.full((faces,), len(face), device=face.device).scatter_reduce(0, face, own, "amin")
    return (first[face] == own).nonzero()[:, 0]


class Division(NamedTuple):
    """Triangles that points divide: either one into three, or two beside an edge into halves.

    Args:
        face: (N,) the triangle that is divided.
        other: (N,) the one beyond the edge; the same where none is.
        made: (N,4,3) the corners of what takes their place; where an edge is not divided, the last is the third again.
        on_edge: (N,) whether an edge is.
    """

    face: Tensor
    other: Tensor
    made: Tensor
    on_edge: Tensor


def _with_points(
    piece: TriangleMesh, points: Tensor, face: Tensor, weights: Tensor, step: float
) -> TriangleMesh | None:
    """The piece with some points (N,3) as vertices, the first of each triangle; None if none can be.

    Args:
        piece: A piece of a surface.
        points: The most important first.
        face: (N,) the triangle of each.
        weights: (N,3) where on it.
        step: Edge of a voxel.
    """
    faces, count, device = piece.faces.long(), len(piece.vertices), piece.device
    around = neighbours(piece.faces, count)[:, :3].long()
    places, new = torch.cat([piece.vertices, points]), torch.arange(len(points), device=device) + count
    least, corner = weights.min(1)
    division = _division(faces, around, face, corner, least < SNAP, new)
    smallest = _areas(places, division.made).amin(1)
    # On the line through an edge's ends, but beyond them: another edge of the vertex that is nearest.
    at_end = ((smallest <= LEAST_AREA * step * step) & (least < SNAP)).nonzero()[:, 0][:MOST_AT_ENDS]
    if len(at_end):
        nearest = faces[face[at_end], weights[at_end].argmax(1)]
        which, fan, start = (faces == nearest[:, None, None]).nonzero(as_tuple=True)
        options = _division(
            faces, around, fan, (start + 2) % 3, torch.ones_like(fan, dtype=torch.bool), new[at_end[which]]
        )
        areas = _areas(places, options.made).amin(1)
        order = torch.argsort(areas, stable=True)
        # Of entries with the same place the last is kept: the largest.
        best = torch.zeros_like(at_end)
        best = best.scatter_reduce(0, which[order], torch.arange(len(order), device=device), "amax")
        for old, found in zip((*division, smallest), (*options, areas), strict=True):
            old[at_end] = found[order[best]]
    rank = torch.where(smallest > LEAST_AREA * step * step, torch.arange(len(points), device=device), len(points))
    first = torch.full((len(piece),), len(points), device=device)
    first = first.scatter_reduce(0, division.face, rank, "amin").scatter_reduce(0, division.other, rank, "amin")
    taken = (rank < len(points)) & (first[division.face] == rank) & (first[division.other] == rank)
    if not bool(taken.any()):
        return None
    numbers = torch.arange(len(places), device=device)
    numbers[new] = count + taken.cumsum(0) - 1
    kept = torch.ones(len(piece), dtype=torch.bool, device=device)
    kept[division.face[taken]] = False
    kept[division.other[taken]] = False
    there = torch.ones(len(points), 4, dtype=torch.bool, device=device)
    there[:, 3] = division.on_edge
    made = numbers[torch.cat([faces[kept], division.made[there & taken[:, None]]])]
    return TriangleMesh(torch.cat([piece.vertices, points[taken]]), made.int(), piece.name, check=False)


def _division(faces: Tensor, around: Tensor, face: Tensor, corner: Tensor, at_edge: Tensor, new: Tensor) -> Division:
    """Division of a triangle, with that beyond the edge across from a corner if that edge is to be divided."""
    # Edge k leads from corner k to the next.
    beyond = around[face, (corner + 1) % 3]
    on_edge = at_edge & (beyond >= 0)
    other = torch.where(on_edge, beyond // 3, face)
    a, b, c = faces[face, corner], faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
    d = faces[other, (beyond + 2) % 3]
    halves = torch.stack([torch.stack(three, 1) for three in ((a, b, new), (a, new, c), (d, c, new), (d, new, b))], 1)
    thirds = torch.stack([torch.stack(three, 1) for three in ((a, b, new), (b, c, new), (c, a, new), (c, a, new))], 1)
    return Division(face.clone(), other, torch.where(on_edge[:, None, None], halves, thirds), on_edge)


def _areas(places: Tensor, triangles: Tensor) -> Tensor:
    """Areas (N,T) of triangles (N,T,3)."""
    a, b, c = places.double()[triangles].unbind(2)
    return torch.linalg.cross(b - a, c - a).norm(dim=-1) / 2
