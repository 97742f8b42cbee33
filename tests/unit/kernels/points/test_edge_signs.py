"""Signs of points near holes by the sum over all boundary edges: those of float64, wherever they are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import half_spheres, sheets, torn, turned
from sdm.bench.common.meshes import torus
from sdm.bench.common.oracles.brute_force import Brute
from sdm.engine.ops import MOST_POINTS
from sdm.engine.plan_override import plan_override
from sdm.kernels.points import edge_signs
from sdm.kernels.points.packets import PACKET

MESHES = {
    "few edges": torn(torus(2000), 0.01),
    "many": torn(torus(8000), 0.2),
    "half turned": turned(torus(2000), 0.5),
    "half spheres": half_spheres(6),
    "sheets": sheets(12),
}


def winding(mesh: tuple[np.ndarray, np.ndarray], points: np.ndarray) -> np.ndarray:
    """The winding number (N,) of a mesh at points (N,3), by all of its faces in float64."""
    return Brute(*mesh, "cpu").winding_number(points)


def near_a_half(mesh: tuple[np.ndarray, np.ndarray], count: int) -> np.ndarray:
    """Points (N,3) float32 whose winding numbers are about 1e-4 off a half, on ways between some inside and outside."""
    rng = np.random.default_rng(1)
    low, high = mesh[0].min(0), mesh[0].max(0)
    begin, end = rng.uniform(low, high, (2, 20 * count, 3))
    below = winding(mesh, begin) < 0.5
    crossing = below != (winding(mesh, end) < 0.5)
    begin, end, below = begin[crossing][:count], end[crossing][:count], below[crossing][:count]
    kept = []
    for _ in range(24):
        middle = ((begin + end) / 2).astype(np.float32)
        found = winding(mesh, middle)
        off = np.abs(found - 0.5)
        kept.append(middle[(off > 2e-5) & (off < 2e-4)])
        first = ((found < 0.5) == below)[:, None]
        begin, end = np.where(first, middle, begin), np.where(first, end, middle)
    # Others end on the surface, where the number jumps.
    return np.concatenate(kept)


@pytest.mark.parametrize("name", MESHES)
def test_sides_are_those_of_the_sum_over_all_faces(name):
    """Also where a bound of 4e-4, as the tree of dipoles has it, leaves the side open."""
    mesh = MESHES[name]
    rng = np.random.default_rng(0)
    spread = rng.uniform(1.2 * mesh[0].min(0), 1.2 * mesh[0].max(0), (300, 3)).astype(np.float32)
    points = np.concatenate([spread, near_a_half(mesh, 100)])
    points[7] = np.nan
    expected = winding(mesh, points)
    given = sdm.TriangleMesh(*mesh, check=False)
    found = sdm.MeshIndex(given, "cpu", warn=False).signed_distance(points).numpy()
    sure = np.abs(expected - 0.5) > 1e-6
    assert np.isnan(found[7])
    assert np.array_equal(found[sure] < 0, expected[sure] > 0.5)
    assert len(points) > 300


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("method", ["lists", "search"])
def test_as_by_other_ways_where_these_are_sure(name, method, monkeypatch):
    mesh = MESHES[name]
    rng = np.random.default_rng(2)
    points = torch.from_numpy(rng.uniform(mesh[0].min(0), mesh[0].max(0), (400, 3)).astype(np.float32))
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh, check=False), "cpu", warn=False)
    with plan_override(points_method=method):
        found = index.signed_distance(points)
        monkeypatch.setattr(edge_signs, "MOST_SUMMED", {"cpu": 0})
        other = index.signed_distance(points)
    sure = torch.from_numpy(np.abs(winding(mesh, points.numpy()) - 0.5) > 1e-3)
    assert torch.equal(found[sure], other[sure])
    assert torch.equal(found.abs(), other.abs())


@pytest.mark.parametrize("points", [1, 10_000, 32 << 20, (32 << 20) + 1, MOST_POINTS])
def test_threads_are_counted_with_32_bits(points):
    packets = -(-points // PACKET)
    lanes, parts = edge_signs.lanes_and_parts(packets, True)
    assert PACKET % parts == 0
    assert packets * parts * lanes < 1 << 31
