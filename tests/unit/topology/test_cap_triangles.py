"""Caps of holes: they close every mesh, are small where holes are, and come from the edges alone."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings

from sdm.bench.common.meshes import load_case, sphere
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.cap_triangles import cap_triangles
from tests.helpers import strategies


def _edges(vertices: np.ndarray, faces: np.ndarray) -> torch.Tensor:
    return boundary_edges(torch.tensor(vertices), torch.tensor(faces))


def _left_over(edges: np.ndarray, caps: np.ndarray) -> dict[tuple[int, int], int]:
    """Directed edges of boundary and caps that do not cancel: none if the caps run along each edge the other way."""
    count: dict[tuple[int, int], int] = {}
    sides = caps[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    for start, end in [*edges.tolist(), *sides.tolist()]:
        if start != end:
            low, high = min(start, end), max(start, end)
            count[low, high] = count.get((low, high), 0) + (1 if start < end else -1)
    return {edge: number for edge, number in count.items() if number}


@settings(max_examples=50)
@given(strategies.soups())
def test_a_capped_soup_is_closed(mesh):
    edges = _edges(mesh.vertices, mesh.faces)
    if len(edges):
        # Surface on the left of its boundary: a cap's edge leads the other way.
        assert not _left_over(edges.numpy(), cap_triangles(edges).numpy())


def test_a_torn_sphere_is_closed_by_small_triangles():
    vertices, faces = sphere(30)
    for share in (0.03, 0.3):
        kept = np.random.default_rng(1).random(len(faces)) >= share
        caps = cap_triangles(_edges(vertices, faces[kept])).numpy()
        assert len(_edges(vertices, np.concatenate([faces[kept], caps]))) == 0
        a, b, c = vertices[caps].transpose(1, 0, 2)
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        assert area < 1.3 * 4 * np.pi * share


def test_a_missing_triangle_is_its_own_cap():
    vertices, faces = sphere(8)
    caps = cap_triangles(_edges(vertices, faces[1:])).numpy()
    (real,) = [cap for cap in caps.tolist() if len(set(cap)) == 3]
    assert sorted(real) == sorted(faces[0].tolist())
    assert np.roll(real, -real.index(faces[0][0])).tolist() == faces[0].tolist()


def test_a_long_loop_has_few_large_triangles():
    case = load_case("open hemisphere")
    edges = _edges(case.vertices, case.faces)
    caps = cap_triangles(edges).numpy()
    size = np.ptp(case.vertices[caps], axis=1).max(1)
    assert (size > 0.5).sum() <= len(edges) // 2
    assert sum(len(set(cap)) == 3 for cap in caps.tolist()) == len(edges) - 2
