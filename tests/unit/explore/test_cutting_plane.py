from __future__ import annotations

import numpy as np
import pytest

import sdm
from sdm.explore.controls import Shown
from sdm.explore.cutting_plane import AXES, coloured, cut, cut_away, place_of

LINEAR = np.array([0.3, -0.2, 0.5])


@pytest.fixture
def shown(field) -> Shown:
    return Shown(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), field, "")


@pytest.fixture
def field() -> sdm.SDM:
    """A linear map, which interpolation does not change, on a grid that is turned and has voxels of three lengths."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    affine = np.eye(4)
    affine[:3, :3] = turn @ np.diag([0.5, 1.0, 0.8])
    affine[:3, 3] = (-2.0, 1.0, -2.5)
    grid = sdm.Grid.from_affine(affine, (6, 5, 7))
    return sdm.SDM((grid.points().numpy() @ LINEAR).astype(np.float32), grid)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("share", [0.0, 0.37, 1.0])
def test_lines_are_where_the_map_has_their_value(shown, axis, share):
    found = cut(shown, axis, share, 1.0)
    assert len(found.lines)
    values = found.lines.reshape(-1, 3) @ LINEAR
    np.testing.assert_allclose(values / found.step, np.round(values / found.step), atol=1e-3)
    if len(found.middle):
        np.testing.assert_allclose(found.middle.reshape(-1, 3) @ LINEAR, 0, atol=1e-4)
    for points in (found.lines, found.middle):
        np.testing.assert_allclose((points.reshape(-1, 3) - found.position) @ found.rotation[:, 2], 0, atol=1e-5)


@pytest.mark.parametrize("axis", AXES)
def test_the_picture_lies_where_its_values_are(shown, axis):
    """Its corners have the colours of the map there; it runs half a voxel beyond the outer voxels' centres."""
    found = cut(shown, axis, 0.5, 2.0)
    assert np.linalg.det(found.rotation) == pytest.approx(1)
    height, width = found.image.shape[:2]
    for row, column in ((height // 2, width // 2), (height // 4, width // 4), (3 * height // 4, width // 3)):
        right = ((column + 0.5) / width - 0.5) * found.size[0]
        up = ((row + 0.5) / height - 0.5) * found.size[1]
        place = found.position + found.rotation @ [right, up, 0.0]
        wanted = coloured(np.asarray(place @ LINEAR / 2.0)).astype(int)
        assert np.abs(found.image[row, column].astype(int) - wanted).max() <= 6


def test_faces_before_the_plane_are_hidden(shown):
    found = cut(shown, "z", 0.5, 1.0)
    heights = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    vertices = (found.position + heights[:, None] * found.rotation[:, 2]).astype(np.float32)
    faces = np.array([[0, 1, 2], [3, 4, 5], [0, 1, 3]], np.int32)
    assert cut_away(vertices, faces, found).tolist() == [[0, 1, 2], [0, 1, 3]]


@pytest.mark.parametrize("axis", AXES)
def test_a_plane_that_is_dragged_says_its_place(field, shown, axis):
    for share in (0.0, 0.3, 1.0):
        plane = cut(shown, axis, share, 1.0)
        beside = plane.position + plane.rotation[:, 0]
        assert place_of(field.grid, axis, beside) == pytest.approx(share, abs=1e-6)
    assert place_of(field.grid, axis, plane.position + 100 * plane.rotation[:, 2]) == 1.0


def test_an_outline_takes_the_place_of_the_lines(field, shown):
    other = field.with_values(field.values - 0.3)
    found = cut(Shown(shown.vertices, shown.faces, field, "", outline=other, grey=True), "z", 0.5, 1.0)
    assert len(found.lines) == 0
    np.testing.assert_allclose(found.middle.reshape(-1, 3) @ LINEAR, 0.3, atol=1e-4)
    assert (np.ptp(found.image.astype(int), axis=2) == 0).all()
