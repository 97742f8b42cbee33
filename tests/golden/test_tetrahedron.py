"""The corner of a cube cut off: three unit axes and a slanted face."""

from __future__ import annotations

import numpy as np
import pytest

import sdm

MESH = sdm.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
IN_RADIUS = 1 / (3 + 3**0.5)
VALUES = [
    ([0.1, 0.2, 0.3], -0.1),
    ([IN_RADIUS] * 3, -IN_RADIUS),
    ([0.3, 0.3, 0.3], -0.1 / 3**0.5),
    ([1, 1, 1], 2 / 3**0.5),
    ([0.25, 0.25, -2], 2),
    ([-3, 0.5, -4], 5),
    ([3, -1, -2], 3),
    ([-2, -1, -2], 3),
    ([1.5, 1.5, -2], 6**0.5),
]


@pytest.mark.parametrize(("point", "expected"), VALUES)
def test_point(point, expected):
    assert float(sdm.signed_distance(MESH, point, device="cpu")) == pytest.approx(expected, abs=1e-6)


def test_map():
    grid = sdm.Grid([0.1, 0.1, 0.1], [0.1, 0.2, 0.3], [2, 2, 2])
    values = sdm.signed_distance_map(MESH, grid, device="cpu").numpy()
    slanted = (1 - grid.points().double().numpy().sum(-1)) / 3**0.5
    inside = np.minimum(grid.points().double().numpy().min(-1), slanted)
    np.testing.assert_allclose(values, -inside, atol=1e-6)


def test_inside_out():
    """Winding number -1 is not more than a half."""
    assert float(sdm.signed_distance(MESH.flipped(), [0.1, 0.2, 0.3], device="cpu")) == pytest.approx(0.1)
