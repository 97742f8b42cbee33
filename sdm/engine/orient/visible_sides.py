"""Sides of patches that are seen from outside, by rays from their faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import warp as wp
from jaxtyping import Bool, Float64, Int64, Integer
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.core.random import derive_seed
from sdm.engine.acceleration import build
from sdm.runtime.torch_warp import as_warp, on_current_stream

# Points on all patches together, on one at least (fewer where there are very many), and all at most.
POINTS, FEWEST, MOST = 1 << 13, 64, 1 << 20


@dataclass(frozen=True)
class Sides:
    """Findings of rays about patches, summed over the points on each.

    Args:
        points: (P,) how many points each patch has.
        front: (P,) rays from its front that meet nothing.
        back: (P,) rays from its back that meet nothing.
        even: (P,) rays from its front that meet an even number of triangles, less those from its back.
        around: (P,) the patch through which most rays leave last, -1 if none does.
    """

    points: Integer[np.ndarray, " P"]
    front: Integer[np.ndarray, " P"]
    back: Integer[np.ndarray, " P"]
    even: Integer[np.ndarray, " P"]
    around: Integer[np.ndarray, " P"]


def visible_sides(
    mesh: TriangleMesh,
    turn: Bool[np.ndarray, " F"],
    patch: Integer[np.ndarray, " F"],
    count: int,
    device: torch.device,
) -> Sides:
    """Look from random points of patches to both sides, the same for the same mesh.

    Args:
        mesh: The mesh, on any device.
        turn: (F,) the faces whose front is what their vertices' order calls the back.
        patch: (F,) the patch of each face.
        count: How many patches there are.
        device: Where rays are followed.
    """
    vertices, faces = mesh.numpy()
    corners = vertices[faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    random = np.random.default_rng(derive_seed(0, "visible sides"))
    chosen = _points(length, patch, count, random)
    owner = patch[chosen]
    unit = np.where(turn[chosen], -1.0, 1.0)[:, None] * normal[chosen] / length[chosen, None]
    u, v = random.random((2, len(chosen)))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], 1)
    origins = (weights[:, :, None] * corners[chosen]).sum(1)
    # A point on a sphere that touches the plane from in front: its direction has the density of the cosine.
    ball = random.normal(size=(len(chosen), 3))
    ahead = unit + (1 - 1e-6) * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    behind = ahead - 2 * (ahead * unit).sum(1, keepdims=True) * unit
    hits, last = _followed(mesh, np.concatenate([origins, origins]), np.concatenate([ahead, behind]), device)
    ahead_hits, behind_hits = np.split(hits, 2)

    def total(marks: np.ndarray) -> np.ndarray:
        return np.bincount(owner, marks, minlength=count).astype(np.int64)

    even = total((ahead_hits % 2 == 0).astype(float) - (behind_hits % 2 == 0))
    around = _most_frequent(np.concatenate([owner, owner]), np.where(last < 0, -1, patch[last]), count)
    return Sides(np.bincount(owner, minlength=count), total(ahead_hits == 0), total(behind_hits == 0), even, around)


def _points(
    weight: Float64[np.ndarray, " F"], patch: Integer[np.ndarray, " F"], count: int, random: np.random.Generator
) -> Int64[np.ndarray, " N"]:
    """The faces on which points lie: of each patch some, by area."""
    order = np.argsort(patch, kind="stable")
    ends = np.cumsum(weight[order])
    size = np.bincount(patch, weight, minlength=count)
    # Of the sum over all faces, where each patch begins.
    begin = np.concatenate([[0.0], ends])[np.searchsorted(patch[order], np.arange(count))]
    fewest = max(1, min(FEWEST, MOST // (2 * count)))
    number = np.maximum(fewest, np.ceil(POINTS * size / max(size.sum(), 1e-300))).astype(np.int64)
    number[size == 0] = 0
    owner = np.repeat(np.arange(count), number)
    # One point in each of so many equal shares of a patch's area.
    share = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number) + random.random(len(owner))
    at = begin[owner] + size[owner] * share / number[owner]
    found = order[np.minimum(np.searchsorted(ends, at, side="right"), len(order) - 1)]
    return found[weight[found] > 0]


def _followed(
    mesh: TriangleMesh, origins: np.ndarray, directions: np.ndarray, device: torch.device
) -> tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, " N"]]:
    """Number of triangles that each ray meets, and the last one, -1 if none."""
    # Maps of faces that are kept as they are do not wait for these kernels to be imported.
    from sdm.kernels.bvh.ray_hits import shoot

    mesh = mesh.to(device)
    faces = mesh.faces
    structure = build(mesh.vertices.detach()[None], faces, faces.new_empty((0, 2)))
    start, way = (torch.from_numpy(a).to(device) for a in (origins, directions))
    counts, last = torch.empty(2, len(origins), dtype=torch.int32, device=device)
    with on_current_stream(start, start, way, *structure.memory):
        rays = (as_warp(tensor, wp.vec3d) for tensor in (start, way))
        shoot(structure.view.tree, *rays, *(as_warp(tensor, wp.int32) for tensor in (counts, last)))
    return _on_host(counts), _on_host(last)


def _on_host(tensor: Tensor) -> np.ndarray:
    return tensor.cpu().numpy().astype(np.int64)


def _most_frequent(owner: np.ndarray, other: np.ndarray, count: int) -> np.ndarray:
    """For each owner the most frequent of the others, not counting itself nor -1."""
    kept = (other >= 0) & (other != owner)
    pairs, times = np.unique(np.stack([owner[kept], other[kept]], 1), axis=0, return_counts=True)
    order = np.argsort(times, kind="stable")
    found = np.full(count, -1)
    # The last one written is the most frequent.
    found[pairs[order, 0]] = pairs[order, 1]
    return found
