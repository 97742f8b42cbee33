"""The unit cube: every voxel of a map against the formula of a box, and its centre, faces, edges and corners."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm

VERTICES = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ],
    np.int32,
)
VALUES = [
    ([0.5, 0.5, 0.5], -0.5),
    ([0.25, 0.5, 0.625], -0.25),
    ([0.5, 0.5, 0.875], -0.125),
    ([0.5, 0.5, 1], 0),
    ([0.25, 0.75, 0], 0),
    ([0, 0, 0.5], 0),
    ([1, 1, 1], 0),
    ([0.5, 0.5, 1.25], 0.25),
    ([-3, 0.125, 0.5], 3),
    ([-3, 0.5, 5], 5),
    ([4, 5, 0.75], 5),
    ([-1, -2, -2], 3),
    ([3, 4, 7], 7),
    ([0, 0, -2], 2),
    ([1, 1, 13], 12),
]


def _box(points: np.ndarray) -> np.ndarray:
    outside = np.abs(points - 0.5) - 0.5
    return np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(-1), 0)


def test_points():
    values = sdm.signed_distance(sdm.TriangleMesh(VERTICES, FACES), [point for point, _ in VALUES], device="cpu")
    assert values.abs().tolist() == [abs(value) for _, value in VALUES]
    off = values != 0
    assert torch.equal(values[off], torch.tensor([float(value) for _, value in VALUES])[off])


@pytest.mark.parametrize("spacing", [(0.5, 0.5, 0.5), (0.25, 0.5, 0.125), (0.125, 1.0, 0.375), (0.3, 0.2, 0.7)])
@pytest.mark.parametrize("origin", [(-0.5, -0.5, -0.5), (0, 0, 0), (-1, -0.25, -0.75), (-0.33, -0.2, -0.41)])
def test_maps(origin, spacing):
    """Voxels on faces, edges and corners, rows of voxels through them, and voxels of three lengths."""
    grid = sdm.Grid(origin, spacing, (9, 6, 7))
    field = sdm.signed_distance_map(sdm.TriangleMesh(VERTICES, FACES), grid, device="cpu")
    expected = _box(grid.points().double().numpy())
    np.testing.assert_allclose(np.abs(field.numpy()), np.abs(expected), rtol=0, atol=4 * 2**-24 * 7)
    off = np.abs(expected) > 4 * 2**-24 * 7
    assert ((field.numpy() < 0) == (expected < 0))[off].all()
    assert field.ambiguous_voxels == 0


def test_one_voxel():
    grid = sdm.Grid((0.5, 0.5, 0.5), (1, 1, 1), (1, 1, 1))
    assert sdm.signed_distance_map(sdm.TriangleMesh(VERTICES, FACES), grid, device="cpu").values.tolist() == [[[-0.5]]]


@pytest.mark.parametrize("axis", range(3))
def test_one_row(axis):
    """Grids one voxel thin in two directions, longer than any block."""
    shape, origin = [1, 1, 1], [0.25, 0.25, 0.25]
    shape[axis], origin[axis] = 97, -1.0
    grid = sdm.Grid(origin, [0.03125] * 3, shape)
    values = sdm.signed_distance_map(sdm.TriangleMesh(VERTICES, FACES), grid, device="cpu").numpy()
    expected = _box(grid.points().double().numpy())
    # To the last bit, but for the voxels on the diagonal of a face.
    np.testing.assert_allclose(np.abs(values), np.abs(expected), rtol=0, atol=2.0**-40)
    assert ((values < 0) == (expected < 0))[expected != 0].all()
