"""The brute force gives what one computes by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.oracle import distance, winding_number

TRIANGLE = np.array([[0, 0, 0], [4, 0, 0], [0, 3, 0]], float)
ONE_FACE = np.array([[0, 1, 2]])

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
CUBE_QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE_FACES = np.array([face for a, b, c, d in CUBE_QUADS for face in ((a, b, c), (a, c, d))])

# Every region of the plane around a 3-4-5 triangle: a point, what is closest to it, and how far that is.
REGIONS = {
    "inside": ((1, 1, 2), (1, 1, 0), 2),
    "below": ((1, 1, -2), (1, 1, 0), 2),
    "corner a": ((-3, -4, 0), (0, 0, 0), 5),
    "corner b": ((7, -1, 0), (4, 0, 0), np.sqrt(10)),
    "corner c": ((-1, 5, 2), (0, 3, 0), 3),
    "edge ab": ((2, -3, 4), (2, 0, 0), 5),
    "edge ca": ((-3, 1, 4), (0, 1, 0), 5),
    "edge bc": ((2 + 3, 1.5 + 4, 0), (2, 1.5, 0), 5),
    "on the face": ((1, 1, 0), (1, 1, 0), 0),
    "on an edge": ((0, 2, 0), (0, 2, 0), 0),
    "on a corner": ((4, 0, 0), (4, 0, 0), 0),
}


@pytest.mark.parametrize("region", REGIONS)
@pytest.mark.parametrize("turn", range(3))
@pytest.mark.parametrize("flip", [False, True])
def test_regions_of_one_triangle(region, turn, flip):
    point, closest, expected = REGIONS[region]
    face = np.roll(ONE_FACE, turn, 1)
    d, at, index = distance(TRIANGLE, face[:, ::-1] if flip else face, np.array([point], float))
    assert d[0] == pytest.approx(expected, abs=1e-14)
    np.testing.assert_allclose(at[0], closest, atol=1e-14)
    assert index[0] == 0


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        ([[0, 0, 0], [1, 0, 0], [3, 0, 0]], 2.0),  # a segment from 0 to 3
        ([[1, 0, 0], [3, 0, 0], [0, 0, 0]], 2.0),
        ([[0, 0, 0], [3, 0, 0], [3, 0, 0]], 2.0),  # a repeated corner
        ([[2, 0, 0], [2, 0, 0], [2, 0, 0]], 2.0),  # a point
        ([[-5, 0, 0], [1, 0, 0], [1, 0, 0]], np.sqrt(5)),
    ],
)
def test_triangles_without_area_are_segments_and_points(corners, expected):
    d, _, _ = distance(np.array(corners, float), ONE_FACE, np.array([[2.0, 2.0, 0.0]]))
    assert d[0] == pytest.approx(expected, abs=1e-15)


def test_cube_by_hand():
    points = np.array([[0, 0, 0], [0.5, 0, 0], [2, 0, 0], [2, 2, 0], [2, 2, 2], [0.9, -0.8, 0.7], [1, 1, 1]])
    d, _, _ = distance(CUBE, CUBE_FACES, points)
    np.testing.assert_allclose(d, [1, 0.5, 1, np.sqrt(2), np.sqrt(3), 0.1, 0], atol=1e-15)
    w = winding_number(CUBE, CUBE_FACES, points[:-1])
    np.testing.assert_allclose(w, [1, 1, 0, 0, 0, 1], atol=1e-14)
    np.testing.assert_allclose(winding_number(CUBE, CUBE_FACES[:, ::-1], points[:-1]), -w, atol=1e-14)


def test_half_of_the_sphere_of_directions():
    """One face of a cube takes a sixth of all directions from the middle; a huge sheet, seen closely, half."""
    square = CUBE_FACES[2:4]
    assert winding_number(CUBE, square, np.zeros((1, 3)))[0] == pytest.approx(1 / 6, abs=1e-15)
    above = np.array([[1 + 1e-9, 0.1, 0.2], [1 - 1e-9, 0.1, 0.2]])
    np.testing.assert_allclose(winding_number(CUBE, square, above), [-0.5, 0.5], atol=1e-8)


def test_the_lowest_of_equal_faces_is_named():
    d, _, face = distance(TRIANGLE, np.repeat(ONE_FACE, 700, 0), np.array([[1.0, 1.0, 1.0]]))
    assert (d[0], face[0]) == (1.0, 0)


def test_sphere_within_its_analytic_bounds():
    """A sphere's mesh lies within its deepest facet of the sphere, and so does every distance."""
    from sdm.bench.common.meshes import sphere

    vertices, faces = sphere(rings=24)
    rng = np.random.default_rng(5)
    points = rng.normal(size=(300, 3)) * 1.2
    radius = np.linalg.norm(points, axis=1)
    a, b, c = np.moveaxis(vertices[faces].astype(float), 1, 0)
    normal = np.cross(b - a, c - a)
    planes = (normal * a).sum(1) / np.linalg.norm(normal, axis=1)
    assert planes.min() > 0.99
    gap = 1 - planes.min() + 1e-6
    d, closest, face = distance(vertices, faces, points)
    assert np.all(np.abs(d - np.abs(radius - 1)) <= gap)
    w = winding_number(vertices, faces, points)
    clear = np.abs(radius - 1) > gap
    np.testing.assert_allclose(w[clear], radius[clear] < 1, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(points - closest, axis=1), d, atol=1e-14)
    alone = [distance(vertices, faces[f][None], p[None])[0][0] for f, p in zip(face, points, strict=True)]
    np.testing.assert_array_equal(alone, d)


def test_steps_do_not_change_the_result(monkeypatch):
    import tests.helpers.oracle as oracle

    rng = np.random.default_rng(2)
    vertices, faces, points = rng.normal(size=(40, 3)), rng.integers(0, 40, (61, 3)), rng.normal(size=(50, 3))
    whole = distance(vertices, faces, points)
    winding = winding_number(vertices, faces, points)
    monkeypatch.setattr(oracle, "POINTS", 7)
    monkeypatch.setattr(oracle, "TRIANGLES", 5)
    for one, other in zip(whole, distance(vertices, faces, points), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(winding_number(vertices, faces, points), winding, atol=1e-15)
