"""A template laid onto a mesh without correspondence: exact distances both ways, as rigid as possible, coarse to fine.

Each turn is a Gauss-Newton step of

    mean_i d(x_i)^2 + mean_j e_j^2 + stiffness * mean_edges |(x_a - x_b) - R_ab (p_a - p_b)|^2

with d the exact signed distance of the template's vertices from the mesh and its gradient, e the exact distance of
points of the mesh from the template, and R the local rotations of Sorkine and Alexa, "As-rigid-as-possible surface
modeling", SGP 2007. The stiffness falls from turn to turn (Amberg et al., "Optimal step nonrigid ICP", CVPR 2007).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.core.random import derive_seed, generator
from sdm.engine.mesh_index import MeshIndex
from sdm.shapes.family_check import crossing_share
from sdm.shapes.models.procrustes import rotations
from sdm.training.conjugate_gradients import conjugate_gradients

TURNS, RIGID_TURNS = 48, 12
STIFF, SOFT = 300.0, 0.05
# Points of the mesh that pull, and steps of conjugate gradients in a turn.
SAMPLES, SOLVES = 4000, 40
# Surfaces that face away from each other do not pull (cosine of the angle between their normals): vertices need a face
# of the mesh that faces alike, points of the mesh one of the template that is not the other wall of the same part. The
# sides of a branch that the template does not reach yet pull at its end, which faces across them.
FACING, FACING_BACK = 0.3, -0.2
# An edge beside a face that would turn over becomes so much stiffer, up to a limit, and loses that again.
STIFFER, STIFFEST, FADING = 4.0, 1000.0, 0.7
# Times that a step is halved around faces that it would turn over; the last time it is left out there.
HALVES = 4
# Steps keep the cosine between a face's normal and that of its turned rest above this; below 0 it is turned over.
MARGIN = 0.05
# A template further than this share of the mesh's diagonal from a part of it has missed that part, a thin vein say. It
# is laid again, towards other points of the mesh, so many times at most.
MISSED, TRIES = 0.05, 3
# Patches that are tried around faces that are turned over at the end, and steps that rotations spread into one.
PATCHES, SPREADS = 12, 60


@dataclass(frozen=True, eq=False)
class Laid:
    """A template on a mesh.

    Args:
        vertices: (V,3) float32, on the device.
        distance: Mean distance of the two surfaces, the mean of both ways, in the meshes' unit.
        most: Largest distance of a vertex or of a sampled point of the mesh.
        turned: Faces of the template that turned over against their surroundings.
        cut: Faces that lie in another part of the laid template: it cuts itself there.
    """

    vertices: Tensor
    distance: float
    most: float
    turned: int
    cut: int


class TemplateLayer:
    """A template prepared for being laid onto meshes.

    Args:
        template: Closed, with about as many vertices as the model is to have.
        device: Where to work.
        stiff: Stiffness of the first turn.
        soft: Stiffness of the last: lower follows the mesh more closely.
        turns: Turns between them.
    """

    def __init__(
        self,
        template: TriangleMesh,
        device: torch.device | str,
        *,
        stiff: float = STIFF,
        soft: float = SOFT,
        turns: int = TURNS,
    ) -> None:
        self.device = torch.device(device)
        self.rest = template.vertices.detach().to(self.device, torch.float32)
        self.faces = template.faces.to(self.device)
        long = self.faces.long()
        pairs = torch.cat([long[:, [0, 1]], long[:, [1, 2]], long[:, [2, 0]]]).sort(1).values
        self._edges, which = torch.unique(pairs, dim=0, return_inverse=True)
        self._edges_of_faces = which.reshape(3, -1)
        self._index = MeshIndex(TriangleMesh(self.rest, self.faces, check=False), device=self.device)
        self._stiff, self._soft, self._turns = stiff, soft, turns

    def lay(self, mesh: TriangleMesh, *, seed: int = 0) -> Laid:
        """The template on a mesh that lies and faces roughly as it does; its place and size are found first.

        Whether a thin part of the mesh is found hangs on the points that pull, and on rounding: where one is missed the
        template is laid again towards others, and the nearest with the fewest turned faces stays.
        """
        target = MeshIndex(mesh, device=self.device)
        box = target.mesh.vertices
        missed = MISSED * float((box.amax(0) - box.amin(0)).norm())
        found = [self._laid_once(target, seed)]
        while found[-1].most > missed and len(found) < TRIES:
            found.append(self._laid_once(target, derive_seed(seed, "laid again", len(found))))
        return min(found, key=lambda laid: (laid.turned, laid.distance))

    def _laid_once(self, target: MeshIndex, seed: int) -> Laid:
        points, normals = surface_samples(target.mesh, SAMPLES, seed, self.device)
        rest = self._placed(target, points)
        x = rest.clone()
        weights = torch.ones(len(self._edges), device=self.device)
        for turn in range(self._turns):
            share = turn / max(1, self._turns - 1)
            stiffness = self._stiff * (self._soft / self._stiff) ** share
            turns = self._local_rotations(rest, x)
            step = self._step(x, rest, turns, target, points, normals, stiffness * weights)
            x, turned = self._without_turning(x, step, rest, turns)
            beside = self._edges_of_faces.reshape(-1)
            count = torch.zeros_like(weights).index_add(0, beside, turned.repeat(3) * 1.0)
            weights = torch.where(count > 0, weights * STIFFER, 1 + (weights - 1) * FADING).clamp_max(STIFFEST)
        return self._judged(self._turned_back(x, rest), rest, target, points)

    def _turned_back(self, x: Tensor, rest: Tensor) -> Tensor:
        """x with faces that turned over put right: a patch around each is what its surroundings make of the rest."""
        for rings in range(1, PATCHES + 1):
            turns = self._local_rotations(rest, x)
            bad = self._turned(x, rest, turns)
            if not bool(bad.any()):
                break
            patch = torch.zeros(len(x), dtype=torch.bool, device=self.device)
            patch[self.faces.long()[bad].reshape(-1)] = True
            x = self._patched(x, rest, turns, self._wider(patch, rings))
        return x

    def _wider(self, mask: Tensor, rings: int) -> Tensor:
        """A mask (V,) of vertices and of those within so many edges of them."""
        a, b = self._edges.unbind(1)
        for _ in range(rings):
            count = mask.float()
            mask = count.index_add(0, a, count[b]).index_add(0, b, count[a]) > 0
        return mask

    def _patched(self, x: Tensor, rest: Tensor, turns: Tensor, patch: Tensor) -> Tensor:
        """x with a patch (V,) laid anew from its rim: the rim's rotations spread into it and turn the rest's edges."""
        a, b = self._edges.unbind(1)
        for _ in range(SPREADS):
            sums = torch.zeros_like(turns).index_add(0, a, turns[b]).index_add(0, b, turns[a])
            turns = torch.where(patch[:, None, None], _unit(sums.flatten(1)).reshape(sums.shape), turns)
        turns = torch.where(patch[:, None, None], _nearest_rotations(turns), turns)
        wanted = torch.einsum("ni,nij->nj", rest[a] - rest[b], (turns[a] + turns[b]) / 2)
        inside = patch[:, None].float()

        def scattered(per_edge: Tensor) -> Tensor:
            return inside * torch.zeros_like(x).index_add(0, a, per_edge).index_add(0, b, -per_edge)

        right = scattered(wanted - (x[a] - x[b]))
        return x + conjugate_gradients(lambda v: scattered(v[a] - v[b]), right, 2 * SOLVES)

    def placed(self, mesh: TriangleMesh, *, seed: int = 0) -> Tensor:
        """Vertices (V,3) of the template moved, turned and scaled as a whole onto a mesh."""
        return self._placed(MeshIndex(mesh, device=self.device), surface_samples(mesh, SAMPLES, seed, self.device)[0])

    def _placed(self, target: MeshIndex, points: Tensor) -> Tensor:
        """The template moved, turned and scaled as a whole: by middles and spreads, then by nearest points."""
        middle, spread = points.mean(0), (points - points.mean(0)).square().sum(1).mean().sqrt()
        own = surface_samples(TriangleMesh(self.rest, self.faces, check=False), SAMPLES, 0, self.device)[0]
        own_middle, own_spread = own.mean(0), (own - own.mean(0)).square().sum(1).mean().sqrt()
        x = (self.rest - own_middle) * (spread / own_spread) + middle
        for _ in range(RIGID_TURNS):
            near = target.signed_distance(x, return_closest=True)[1].points
            self._index.update(x)
            back = self._index.signed_distance(points, return_closest=True, sign="none")[1].points
            source, goal = torch.cat([x, back]).double(), torch.cat([near, points]).double()
            a, b = source - source.mean(0), goal - goal.mean(0)
            turn = rotations(a[None], b)[0]
            factor = ((a @ turn) * b).sum() / a.square().sum()
            x = ((x.double() - source.mean(0)) @ turn * factor + goal.mean(0)).float()
        return x

    def _local_rotations(self, rest: Tensor, x: Tensor) -> Tensor:
        """Rotation (V,3,3), applied from the right, of each vertex's edges from rest to x."""
        a, b = self._edges.unbind(1)
        outer = (rest[a] - rest[b])[:, :, None] * (x[a] - x[b])[:, None, :]
        covariance = torch.zeros(len(rest), 3, 3, device=self.device)
        covariance = covariance.index_add(0, a, outer).index_add(0, b, outer)
        return _nearest_rotations(covariance)

    def _step(
        self,
        x: Tensor,
        rest: Tensor,
        turns: Tensor,
        target: MeshIndex,
        points: Tensor,
        normals: Tensor,
        stiffness: Tensor,
    ) -> Tensor:
        """The Gauss-Newton step (V,3)."""
        a, b = self._edges.unbind(1)
        # Vertices against the mesh.
        d, hit = target.signed_distance(x, return_closest=True)
        way = _unit(x - hit.points) * d.sign()[:, None]
        face_normals = _face_normals(target.mesh.vertices, target.mesh.faces)[hit.faces.long()]
        way = torch.where((d.abs() > 1e-4 * (x.amax() - x.amin()))[:, None], way, face_normals)
        own = _vertex_normals(x, self.faces)
        front = ((own * face_normals).sum(1) > FACING).float() / len(x)
        # Points of the mesh against the template.
        self._index.update(x)
        near = self._index.signed_distance(points, return_closest=True, sign="none")[1]
        gap = points - near.points
        corners = self.faces.long()[near.faces.long()]
        fitting = (_face_normals(x, self.faces)[near.faces.long()] * normals).sum(1) > FACING_BACK
        e = gap.norm(dim=1)
        pull = torch.where((e > 1e-6)[:, None], _unit(gap), normals)
        back = fitting.float() / len(points)
        share = near.barycentric
        # Edges against their rotated rest.
        wanted = torch.einsum("ni,nij->nj", rest[a] - rest[b], (turns[a] + turns[b]) / 2)
        stretch = (x[a] - x[b]) - wanted
        weight = (stiffness / len(self._edges))[:, None]

        def scattered(per_edge: Tensor) -> Tensor:
            return torch.zeros_like(x).index_add(0, a, per_edge).index_add(0, b, -per_edge)

        def from_points(amount: Tensor) -> Tensor:
            spread = (share * amount[:, None])[:, :, None] * pull[:, None, :]
            return torch.zeros_like(x).index_add(0, corners.reshape(-1), spread.reshape(-1, 3))

        def normal_equations(v: Tensor) -> Tensor:
            along = (front * (v * way).sum(1))[:, None] * way
            moved = (share[:, :, None] * v[corners]).sum(1)
            # A little of all directions keeps what nothing pulls where it is.
            return along + from_points(back * (moved * pull).sum(1)) + scattered(weight * (v[a] - v[b])) + 1e-6 * v

        right = -(front * d)[:, None] * way + from_points(back * e) - scattered(weight * stretch)
        return conjugate_gradients(normal_equations, right, SOLVES)

    def _without_turning(self, x: Tensor, step: Tensor, rest: Tensor, turns: Tensor) -> tuple[Tensor, Tensor]:
        """x after the step, shortened around faces that would turn over, and these faces."""
        first = bad = self._turned(x + step, rest, turns)
        share = torch.ones(len(x), device=self.device)
        for half in range(HALVES):
            touched = torch.zeros_like(share).index_add(
                0, self.faces.long().reshape(-1), bad.repeat_interleave(3) * 1.0
            )
            share = torch.where(touched > 0, 0.0 if half == HALVES - 1 else share / 2, share)
            bad = self._turned(x + share[:, None] * step, rest, turns)
        return x + share[:, None] * step, first

    def _turned(self, x: Tensor, rest: Tensor, turns: Tensor, margin: float = MARGIN) -> Tensor:
        """Mask (F,) of faces whose normal points against that of their rest, turned as their vertices are."""
        mean = turns[self.faces.long()].mean(1)
        wanted = torch.einsum("ni,nij->nj", _face_normals(rest, self.faces), mean)
        return (_face_normals(x, self.faces) * wanted).sum(1) <= margin

    def _judged(self, x: Tensor, rest: Tensor, target: MeshIndex, points: Tensor) -> Laid:
        self._index.update(x)
        own, _ = surface_samples(TriangleMesh(x, self.faces, check=False), SAMPLES, 1, self.device)
        there = target.signed_distance(own).abs()
        back = self._index.signed_distance(points, sign="none")
        turned = self._turned(x, rest, self._local_rotations(rest, x), 0.0)
        figures = torch.stack([(there.mean() + back.mean()) / 2, torch.maximum(there.max(), back.max())])
        distance, most = figures.tolist()
        mesh = TriangleMesh(x, self.faces, check=False)
        cut = round(crossing_share(mesh, float((x.amax(0) - x.amin(0)).max()), self.device) * len(self.faces))
        return Laid(x, distance, most, int(turned.sum()), cut)


def surface_samples(mesh: TriangleMesh, count: int, seed: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Points (count,3) spread evenly over a mesh's area, and the normals there."""
    vertices, faces = mesh.vertices.detach().to(device), mesh.faces.to(device)
    corners = vertices[faces.long()]
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1).double()
    ends = area.cumsum(0)
    random = torch.rand(3, count, generator=generator(seed, "points of a mesh"), device="cpu").to(device)
    # One point in each of `count` equal parts of the area.
    place = (torch.arange(count, device=device) + random[0].double()) / count * ends[-1]
    which = torch.searchsorted(ends, place).clamp_max(len(faces) - 1)
    root = random[1].sqrt()
    share = torch.stack([1 - root, root * (1 - random[2]), root * random[2]], 1)
    return (share[:, :, None] * corners[which]).sum(1), _face_normals(vertices, faces)[which]


def _nearest_rotations(matrices: Tensor) -> Tensor:
    """Rotations (N,3,3) nearest to matrices (N,3,3)."""
    u, _, vt = torch.linalg.svd(matrices)
    sign = torch.linalg.det(u @ vt).sign()
    return torch.cat([u[:, :, :2], u[:, :, 2:] * sign[:, None, None]], 2) @ vt


def _unit(v: Tensor) -> Tensor:
    return v / v.norm(dim=1, keepdim=True).clamp_min(1e-20)


def _face_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    a, b, c = vertices[faces.long()].unbind(1)
    return _unit(torch.linalg.cross(b - a, c - a))


def _vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    a, b, c = vertices[faces.long()].unbind(1)
    normals = torch.linalg.cross(b - a, c - a)[:, None].expand(-1, 3, -1).reshape(-1, 3)
    return _unit(torch.zeros_like(vertices).index_add(0, faces.long().reshape(-1), normals))
