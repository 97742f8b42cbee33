from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sdm.core.grid import IDENTITY, Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import GridError

BOX = TriangleMesh([[0, 0, 0], [4, 0, 0], [0, 2, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "box")
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def rotation(seed: int) -> np.ndarray:
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.sign(np.linalg.det(matrix))


def test_points_are_voxel_centres():
    points = Grid((1, 2, 3), (0.5, 1, 2), (2, 3, 4)).points()
    assert points.shape == (2, 3, 4, 3)
    assert points.dtype == torch.float32
    assert points[1, 2, 3].tolist() == [1.5, 4.0, 9.0]


def test_points_of_a_slab_are_those_of_the_whole():
    grid = Grid((0.1, 0.2, 0.3), (0.7, 0.1, 0.3), (7, 3, 2), rotation(1))
    assert torch.equal(grid.points(2, 5), grid.points()[2:5])


def test_points_agree_with_the_affine():
    grid = Grid((-1, 2, 5), (0.5, 0.25, 2), (3, 4, 5), rotation(0))
    index = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1)
    expected = index @ grid.affine[:3, :3].T + grid.affine[:3, 3]
    np.testing.assert_allclose(grid.points().numpy(), expected, atol=1e-6)


@given(
    st.lists(st.floats(-1e6, 1e6, width=32), min_size=6, max_size=6),
    st.integers(1, 600),
    st.sampled_from([0.0, 0.05, 0.3]),
)
def test_a_plain_number_of_voxels_gives_the_same_bits_as_an_array(ends, resolution, margin):
    low, high = np.sort(np.reshape(ends, (2, 3)).astype(np.float64), 0)
    if (high == low).all():
        return
    by_numpy: Any = np.int64(resolution)
    found = Grid.around_box(low, high, resolution, margin=margin)
    assert found == Grid.around_box(low, high, by_numpy, margin=margin)
    extent = (high - low).max()
    step = (extent + 2 * (margin * extent)) / np.maximum(resolution - 1, 1)
    assert found == Grid((low + high) / 2 - step * (resolution - 1) / 2, (step,) * 3, (resolution,) * 3)


def test_size_and_bytes():
    grid = Grid((0, 0, 0), (1, 1, 1), (2, 3, 4))
    assert (grid.size, grid.nbytes) == (24, 96)


def test_numbers_of_any_kind_become_plain_tuples():
    grid = Grid(np.zeros(3), [1, 2, 3], np.array([4, 5, 6]), np.eye(3))
    assert grid == Grid((0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (4, 5, 6))
    assert hash(grid) == hash(Grid((0, 0, 0), (1, 2, 3), (4, 5, 6)))
    assert all(type(n) is int for n in grid.shape)


def test_a_resolution_may_be_an_array():
    assert Grid.around(BOX, np.array([9, 8, 7])) == Grid.around(BOX, (9, 8, 7))


@pytest.mark.parametrize("resolution", [1, 2, 33])
def test_around_with_a_resolution_is_a_centred_cube(resolution):
    grid = Grid.around(BOX, resolution=resolution, margin=0.25)
    assert grid.shape == (resolution,) * 3
    assert len(set(grid.spacing)) == 1
    centre = np.asarray(grid.origin) + np.asarray(grid.spacing) * (resolution - 1) / 2
    np.testing.assert_allclose(centre, [2, 1, 0.5], atol=1e-12)
    if resolution > 1:
        assert grid.spacing[0] * (resolution - 1) == pytest.approx(6.0)


def test_around_defaults_to_128():
    assert Grid.around(BOX).shape == (128, 128, 128)


@given(st.floats(0.05, 3), st.floats(0.05, 3), st.floats(0.05, 3), st.floats(0, 1))
def test_around_with_a_spacing_holds_the_mesh_and_its_margin(x, y, z, margin):
    grid = Grid.around(BOX, spacing=(x, y, z), margin=margin)
    first = np.asarray(grid.origin)
    last = first + np.asarray(grid.spacing) * (np.asarray(grid.shape) - 1)
    room = margin * 4
    slack = 1e-5 * np.asarray(grid.spacing)
    assert (first <= -room + slack).all()
    assert (last >= np.array([4, 2, 1]) + room - slack).all()
    assert (last - first < np.array([4, 2, 1]) + 2 * room + np.asarray(grid.spacing)).all()


def test_around_with_one_spacing_takes_it_for_every_axis():
    grid = Grid.around(BOX, spacing=0.5, margin=0.0)
    assert grid.spacing == (0.5, 0.5, 0.5)
    assert grid.shape == (9, 5, 3)


def test_a_single_point_has_a_grid_with_a_spacing():
    point = TriangleMesh(np.ones((3, 3)), [[0, 1, 2]])
    assert Grid.around(point, spacing=2.0) == Grid((1, 1, 1), (2, 2, 2), (1, 1, 1))


def test_the_affine_gives_the_grid_back():
    grid = Grid((1, -2, 3), (0.5, 0.25, 2), (3, 4, 5), TURN)
    assert Grid.from_affine(grid.affine, grid.shape) == grid
    assert not grid.is_axis_aligned


@pytest.mark.parametrize("flip", [(1, 1, 1), (-1, 1, 1), (-1, -1, 1)])
def test_a_header_in_float32_gives_an_exactly_orthonormal_direction(flip):
    for seed in range(20):
        affine = Grid((1, 2, 3), (0.7, 0.8, 0.9), (4, 4, 4), rotation(seed) * flip).affine.astype(np.float32)
        back = Grid.from_affine(affine, (4, 4, 4))
        direction = np.asarray(back.direction)
        np.testing.assert_allclose(direction.T @ direction, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(back.affine, affine, atol=1e-6)
        assert np.linalg.det(direction) * np.prod(flip) > 0


def test_rounding_in_a_straight_header_is_taken_for_straight():
    affine = np.diag([0.7, 0.8, 0.9, 1.0]).astype(np.float32)
    affine[0, 1] = 1e-9
    assert Grid.from_affine(affine, (2, 2, 2)).direction == IDENTITY


@pytest.mark.parametrize(
    ("origin", "spacing", "shape", "direction", "says"),
    [
        ((0, 0), (1, 1, 1), (1, 1, 1), IDENTITY, "origin must be three numbers"),
        ((0, 0, "x"), (1, 1, 1), (1, 1, 1), IDENTITY, "origin must be three numbers"),
        ((0, 0, np.nan), (1, 1, 1), (1, 1, 1), IDENTITY, "not finite"),
        ((0, 0, 0), (1, 1, 0), (1, 1, 1), IDENTITY, "positive"),
        ((0, 0, 0), (1, 1, -1), (1, 1, 1), IDENTITY, "positive"),
        ((0, 0, 0), (1, 1, np.inf), (1, 1, 1), IDENTITY, "positive"),
        ((0, 0, 0), 1.0, (1, 1, 1), IDENTITY, "spacing must be three numbers"),
        ((0, 0, 0), (1, 1, 1), (0, 1, 1), IDENTITY, "at least 1"),
        ((0, 0, 0), (1, 1, 1), (1, 1, -4), IDENTITY, "at least 1"),
        ((0, 0, 0), (1, 1, 1), (1, 1, 1.5), IDENTITY, "whole numbers"),
        ((0, 0, 0), (1, 1, 1), (1, 1, np.nan), IDENTITY, "whole numbers"),
        ((0, 0, 0), (1, 1, 1), (1, 1, np.inf), IDENTITY, "whole numbers"),
        ((0, 0, 0), (1, 1, 1), None, IDENTITY, "shape must be three numbers"),
        ((0, 0, 0), (1, 1, 1), (1, 1, 1), np.eye(4), "3 x 3"),
        ((0, 0, 0), (1, 1, 1), (1, 1, 1), ((1, 0), (0,)), "3 x 3"),
        ((0, 0, 0), (1, 1, 1), (1, 1, 1), np.full((3, 3), np.nan), "3 x 3"),
        ((0, 0, 0), (1, 1, 1), (1, 1, 1), [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]], "sheared"),
    ],
)
def test_bad_grids_are_refused(origin, spacing, shape, direction, says):
    with pytest.raises(GridError, match=says):
        Grid(origin, spacing, shape, direction)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"resolution": 8, "spacing": 1.0}, "not both"),
        ({"resolution": 0}, "at least 1"),
        ({"resolution": -8}, "at least 1"),
        ({"resolution": 1.5}, "whole number"),
        ({"resolution": float("nan")}, "whole number"),
        ({"resolution": "128"}, "whole number"),
        ({"resolution": True}, "whole number"),
        ({"spacing": 0}, "positive"),
        ({"spacing": -1.0}, "positive"),
        ({"spacing": (1.0, float("nan"), 1.0)}, "positive"),
        ({"spacing": (1.0, 2.0)}, "three numbers"),
        ({"spacing": "fine"}, "three numbers"),
        ({"spacing": 1e-12}, "choose a larger one"),
        ({"resolution": 8, "margin": -0.1}, "margin"),
        ({"resolution": 8, "margin": float("nan")}, "margin"),
    ],
)
def test_bad_wishes_are_refused(options, says):
    with pytest.raises(GridError, match=says):
        Grid.around(BOX, **options)


def test_a_mesh_of_size_zero_needs_a_spacing():
    with pytest.raises(GridError, match="size zero"):
        Grid.around(TriangleMesh(np.ones((3, 3)), [[0, 1, 2]]), resolution=8)


@pytest.mark.parametrize(
    ("affine", "says"),
    [(np.eye(3), "4 x 4"), (np.diag([1.0, 0.0, 1.0, 1.0]), "no volume"), (np.full((4, 4), np.nan), "4 x 4")],
)
def test_bad_affines_are_refused(affine, says):
    with pytest.raises(GridError, match=says):
        Grid.from_affine(affine, (2, 2, 2))
