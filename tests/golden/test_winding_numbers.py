"""Winding numbers that symmetry tells: shares of a sphere by cubes and octants."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
import sdm.engine.structure.sizes
from sdm.bench.common.meshes import cube

VERTICES, FACES = cube()
# The last two faces are the side z = 1, the first two x = -1.


def _winding(faces: np.ndarray, points: list[list[float]], vertices: np.ndarray = VERTICES) -> torch.Tensor:
    return sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu").winding_number(points)


@pytest.fixture(params=["boundary", "dipoles"])
def way(request, monkeypatch):
    """Both ways in which open meshes are counted; the second is good to 4e-4 here."""
    if request.param == "dipoles":
        monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", 0)
        return 2e-3
    return 1e-6


def test_whole_numbers():
    points = [[0.0, 0, 0], [0.9, 0.9, -0.9], [2, 0, 0], [-2, 1, 1], [-5, -1, -1]]
    inside = [1.0, 1, 0, 0, 0]
    assert _winding(FACES, points).tolist() == inside
    assert _winding(FACES[:, ::-1], points).tolist() == [-w for w in inside]
    assert _winding(np.concatenate([FACES, FACES]), points).tolist() == [2 * w for w in inside]
    assert _winding(np.concatenate([FACES, FACES[:, ::-1]]), points).tolist() == [0] * 5


@pytest.mark.parametrize("side", range(6))
def test_a_cube_without_a_side(way, side):
    """Each side is a sixth of what is seen from the centre, from within or from the centre of the next cube."""
    faces = np.delete(FACES, [2 * side, 2 * side + 1], axis=0)
    corner = VERTICES[FACES[2 * side : 2 * side + 2].reshape(-1)]
    outward = 2.0 * np.round(corner.mean(0))
    found = _winding(faces, [[0, 0, 0], outward.tolist()])
    np.testing.assert_allclose(found, [5 / 6, 1 / 6], atol=way)


def test_a_side_alone(way):
    assert float(_winding(FACES[:2], [[0.0, 0, 0]])[0]) == pytest.approx(1 / 6, abs=way)
    assert float(_winding(FACES[:2], [[-2.0, 0, 0]])[0]) == pytest.approx(-1 / 6, abs=way)


def test_half_a_side(way):
    assert float(_winding(FACES[:-1], [[0.0, 0, 0]])[0]) == pytest.approx(11 / 12, abs=way)


def test_an_octant(way):
    """A triangle on three orthogonal axes is an eighth of the sphere."""
    vertices = np.array([[1, 0, 0], [0, 3, 0], [0, 0, 0.5]], np.float32)
    assert float(_winding(np.array([[0, 1, 2]]), [[0.0, 0, 0]], vertices)[0]) == pytest.approx(1 / 8, abs=way)


def test_close_to_a_sheet(way):
    """Half the sphere on either side, with the sign of the side."""
    points = [[-1 + 1e-4, 0.1, 0.2], [-1 - 1e-4, 0.1, 0.2]]
    np.testing.assert_allclose(_winding(FACES[:2], points), [0.5, -0.5], atol=2e-3)


@pytest.mark.parametrize("x", [-1.5, -2.0, -3.0, -7.0, -1000.0])
def test_behind_the_corners_of_an_open_cube(x):
    """In line with a boundary corner: the limit from all sides, which symmetry makes the same for opposite corners."""
    faces = FACES[:-2]  # without z = 1
    points = np.array([[x, y, 1] for y in (-1, 1)] + [[x, y, 1 + 1e-5] for y in (-1, 1)])
    found = _winding(faces, points.tolist())
    assert float(found[0]) == pytest.approx(float(found[1]), abs=1e-6)
    np.testing.assert_allclose(found[:2], found[2:], atol=1e-5)


def test_ambiguous_voxels():
    """Counted are the voxels whose winding number is within a quarter of a half; closed meshes have none."""
    grid = sdm.Grid([-2] * 3, [0.25] * 3, [17] * 3)
    closed = sdm.signed_distance_map(sdm.TriangleMesh(VERTICES, FACES), grid, device="cpu")
    assert closed.ambiguous_voxels == 0
    index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES, FACES[:-2]), "cpu")
    winding = index.winding_number(grid.points())
    expected = int(((winding - 0.5).abs() < 0.25).sum())
    assert expected > 100
    # On the surface itself the number is anybody's.
    at_most = int((index.signed_distance(grid.points()).abs() < 1e-6).sum())
    found = index.signed_distance_map(grid).ambiguous_voxels
    assert found is not None
    assert abs(found - expected) <= at_most


def test_signs_follow_a_half():
    """An open cube is inside where more than half the sphere is covered, on the open side too."""
    index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES, FACES[:-2]), "cpu")
    points = [[0.0, 0, z] for z in np.linspace(-0.9, 1.9, 57)]
    winding, values = index.winding_number(points), index.signed_distance(points)
    assert torch.equal(values < 0, winding > 0.5)
    assert (values < 0).any()
    assert (values > 0).any()
