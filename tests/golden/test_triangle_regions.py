"""One triangle, each of its seven Voronoi regions: 3-4-5 and 5-12-13 make every value a whole number."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import sdm

A, B, C = [0.0, 0, 0], [4.0, 0, 0], [0.0, 3, 0]
# Region, point, distance, closest point, barycentric coordinates of A, B, C.
REGIONS = [
    ("face", [1, 1, 2], 2, [1, 1, 0], [5 / 12, 3 / 12, 4 / 12]),
    ("face from behind", [1, 1, -2], 2, [1, 1, 0], [5 / 12, 3 / 12, 4 / 12]),
    ("edge AB", [2, -3, 4], 5, [2, 0, 0], [0.5, 0.5, 0]),
    ("edge BC", [5, 5.5, 12], 13, [2, 1.5, 0], [0, 0.5, 0.5]),
    ("edge CA", [-5, 1.5, 12], 13, [0, 1.5, 0], [0.5, 0, 0.5]),
    ("corner A", [-1, -2, 2], 3, A, [1, 0, 0]),
    ("corner B", [6, -1, 2], 3, B, [0, 1, 0]),
    ("corner C", [-2, 4, 2], 3, C, [0, 0, 1]),
    ("in the plane", [2, -5, 0], 5, [2, 0, 0], [0.5, 0.5, 0]),
    ("on the face", [1, 1, 0], 0, [1, 1, 0], [5 / 12, 3 / 12, 4 / 12]),
    ("on an edge", [1, 0, 0], 0, [1, 0, 0], [0.75, 0.25, 0]),
    ("on a corner", B, 0, B, [0, 1, 0]),
]


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
@pytest.mark.parametrize(
    ("point", "distance", "closest", "weights"), [row[1:] for row in REGIONS], ids=[row[0] for row in REGIONS]
)
def test_region(order, point, distance, closest, weights):
    vertices = np.array([A, B, C], np.float32)[list(order)]
    mesh = sdm.TriangleMesh(vertices, [[0, 1, 2]])
    value, hit = sdm.signed_distance(mesh, [point], return_closest=True, device="cpu")
    # A sheet has no inside.
    assert value.tolist() == [distance]
    assert hit.faces.tolist() == [0]
    np.testing.assert_allclose(hit.points[0], closest, atol=1e-6)
    np.testing.assert_allclose(hit.barycentric[0], np.array(weights)[list(order)], atol=1e-6)


@pytest.mark.parametrize("power", [-60, -10, 20, 60])
def test_any_size(power):
    factor = 2.0**power
    mesh = sdm.TriangleMesh(np.array([A, B, C]) * factor, [[0, 1, 2]])
    points = np.array([row[1] for row in REGIONS]) * factor
    values = sdm.signed_distance(mesh, points, device="cpu")
    assert (values / factor).tolist() == [row[2] for row in REGIONS]


def test_as_a_map():
    """The same values where the points are voxels: planes through z = -2, 0, 2 and so on."""
    mesh = sdm.TriangleMesh([A, B, C], [[0, 1, 2]])
    for name, point, distance, *_ in REGIONS:
        grid = sdm.Grid(np.array(point) - 2 * np.array([0.5, 0.25, 1]), [0.5, 0.25, 1], [5, 4, 3])
        value = float(sdm.signed_distance_map(mesh, grid, device="cpu").values[2, 2, 2])
        assert abs(value - distance) <= 4 * 2**-24 * 12, name
