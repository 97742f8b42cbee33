"""Distances in rational arithmetic: known values of segments and points, and the float64 brute force elsewhere."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from sdm.bench.common.degenerate_meshes import filled_t_junctions, thin_soup
from sdm.bench.common.mesh_formulas import cube, inverted, joined, moved, sphere
from sdm.bench.common.oracles import rational
from tests.helpers import oracle


@pytest.mark.parametrize(
    ("corner", "point", "squared"),
    [
        ([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [1, 1, -3], Fraction(9)),
        ([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [3, 3, 1], Fraction(3)),
        ([[0, 0, 0], [3, 3, 3], [1, 1, 1]], [1, 0, 0], Fraction(2, 3)),
        ([[1, 2, 3]] * 3, [4, 6, 15], Fraction(169)),
        # A third of the height over an edge that float32 cannot divide.
        ([[0, 0, 0], [3, 1, 0], [3, 1, 0]], [0, 1, 0], Fraction(9, 10)),
    ],
    ids=["plane", "edge", "segment", "point", "turned segment"],
)
def test_known_triangles(corner, point, squared):
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        triangle = np.array(corner, np.float32)[order]
        assert rational.squared_distance(np.array(point, np.float32), triangle) == squared


def test_an_unseen_height():
    """A triangle that float64 takes for a segment still has a plane."""
    corner = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-30, 0]], np.float32)
    point = np.array([0.5, 5e-31, 1], np.float32)
    assert rational.squared_distance(point, corner) == 1


@pytest.mark.parametrize("kind", ["any", "thin"])
def test_against_the_float64_brute_force(kind):
    rng = np.random.default_rng(2)
    for _ in range(20):
        corner = rng.normal(size=(3, 3, 3)).astype(np.float32) if kind == "any" else thin_soup(rng, 3)
        vertices, faces = corner.reshape(-1, 3), np.arange(9).reshape(3, 3)
        points = rng.normal(size=(10, 3)).astype(np.float32)
        points[::2] = (corner[0, 0] + rng.uniform(-1, 2, (5, 1)) * (corner[0, 1] - corner[0, 0])).astype(np.float32)
        expected = oracle.distance(vertices, faces, points)[0]
        found = rational.distance(vertices, faces, points)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 if kind == "any" else 1e-10)


@pytest.mark.parametrize("solid", [filled_t_junctions, lambda: joined(sphere(3), moved(inverted(sphere(3)), 0.5))])
def test_winding_numbers_against_the_float64_brute_force(solid):
    vertices, faces = solid()
    points = np.random.default_rng(5).uniform(-1.5, 1.5, (40, 3)).astype(np.float32)
    found = [rational.winding_number(vertices[faces], point) for point in points]
    np.testing.assert_allclose(found, oracle.winding_number(vertices, faces, points), rtol=0, atol=1e-6)
    assert 0 < np.count_nonzero(found) < len(found)


def test_winding_numbers_in_line_with_edges():
    """On the lines of edges, in the planes of faces, and beside a triangle without area."""
    vertices, faces = cube()
    flat = np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]])
    for point, expected in [([0, 0, 0], 1), ([0, 0, 3], 0), ([2, 1, 1], 0), ([1, 1, 3], 0), ([3, 3, 3], 0)]:
        assert rational.winding_number(vertices[flat], np.array(point, np.float32)) == expected


@pytest.mark.parametrize("point", [[1, 0.25, 0.5], [1, 1, 0], [1, 1, 1]], ids=["face", "edge", "corner"])
def test_no_winding_number_on_the_surface(point):
    vertices, faces = cube()
    with pytest.raises(ValueError, match="on the surface"):
        rational.winding_number(vertices[faces], np.array(point, np.float32))
