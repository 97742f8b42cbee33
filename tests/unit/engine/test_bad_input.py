"""Input that cannot be measured is refused with one sentence that says what is wrong."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube

VERTICES, FACES = cube()
MESH = sdm.TriangleMesh(VERTICES, FACES)
GRID = sdm.Grid([0, 0, 0], [1, 1, 1], [2, 2, 2])


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (3.0, r"\(\); \(\.\.\., 3\)"),
        ([1.0, 2], r"\(2,\)"),
        (np.zeros((3, 4)), r"\(3, 4\)"),
        (torch.zeros(4, 2), r"\(4, 2\)"),
        (np.zeros((1, 3), complex), "complex"),
        (np.zeros((1, 3), bool), "bool"),
        ([[1.0, 2, 3], [4.0, 5]], "different lengths"),
        ("points.ply", "array of numbers"),
        (None, "array of numbers"),
    ],
)
def test_points(points, message):
    with pytest.raises(sdm.MeshError, match=message):
        sdm.signed_distance(MESH, points, device="cpu")
    index = sdm.MeshIndex(MESH, "cpu")
    with pytest.raises(sdm.MeshError, match=message):
        index.signed_distance(points)
    with pytest.raises(sdm.MeshError, match=message):
        index.winding_number(points)


@pytest.mark.parametrize("device", ["cuda:99", "meta", "gpu", "mps", ""])
def test_devices(device):
    calls = [
        lambda: sdm.signed_distance(MESH, [[0, 0, 0]], device=device),
        lambda: sdm.signed_distance_map(MESH, GRID, device=device),
        lambda: sdm.signed_distance_maps(VERTICES[None], FACES, GRID, device=device),
        lambda: sdm.MeshIndex(MESH, device),
    ]
    for call in calls:
        with pytest.raises(sdm.DeviceError, match=r"use cpu|only cuda:0"):
            call()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device here")
def test_cuda_where_there_is_none():
    with pytest.raises(sdm.DeviceError, match="no CUDA device is there; use cpu"):
        sdm.signed_distance_map(MESH, GRID, device="cuda")


def test_a_grid_that_cannot_fit():
    grid = sdm.Grid([0, 0, 0], [1, 1, 1], [1 << 14, 1 << 14, 1 << 14])
    with pytest.raises(
        sdm.GridError, match=r"16384 x 16384 x 16384 voxels needs 16384\.0 GiB, but cpu has .* GiB free"
    ):
        sdm.signed_distance_map(MESH, grid, device="cpu")
    with pytest.raises(sdm.GridError, match=r"2 maps needs 32768\.0 GiB"):
        sdm.signed_distance_maps(np.stack([VERTICES, VERTICES]), FACES, grid, device="cpu")


def test_a_grid_that_cannot_fit_comes_in_slabs():
    grid = sdm.Grid([0, 0, 0], [1, 1, 1], [1 << 24, 1 << 6, 1 << 10])
    begin, end, values = next(sdm.MeshIndex(MESH, "cpu").slabs(grid, max_bytes=1 << 21))
    assert (begin, end) == (0, 32)
    assert values.shape == (32, 1 << 6, 1 << 10)
    assert values[0, 0, :3].tolist() == [-1, 0, 1]


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (VERTICES, FACES, r"\(8, 3\); \(B, V, 3\)"),
        (np.zeros((0, 8, 3)), FACES, r"\(0, 8, 3\)"),
        (np.zeros((2, 8, 2)), FACES, r"\(2, 8, 2\)"),
        (VERTICES[None], FACES.reshape(-1), r"\(36,\); \(F, 3\)"),
        (VERTICES[None], np.zeros((0, 3), int), r"F > 0"),
        (VERTICES[None], FACES[:, :2], r"\(12, 2\)"),
        (VERTICES[None], FACES + 1, "vertex 8, but the 8 vertices are numbered 0 to 7"),
        (VERTICES[None], FACES - 1, "vertex -1"),
        (VERTICES[None], FACES.astype(float), "integers"),
    ],
)
def test_batches(vertices, faces, message):
    with pytest.raises(sdm.MeshError, match=message):
        sdm.signed_distance_maps(vertices, faces, GRID, device="cpu")


def test_a_batch_on_a_turned_grid():
    turned = sdm.Grid([0, 0, 0], [0.3, 0.4, 0.5], [5, 4, 3], [[0, 1, 0], [0.6, 0, 0.8], [-0.8, 0, 0.6]])
    batch = sdm.signed_distance_maps(np.stack([VERTICES, 2 * VERTICES]), FACES, turned, device="cpu")
    for values, scale in zip(batch, (1, 2), strict=True):
        one = sdm.signed_distance_map(sdm.TriangleMesh(scale * VERTICES, FACES), turned, device="cpu")
        assert torch.equal(values, one.values)


@pytest.mark.parametrize("orient", ["outward", "", None, True])
def test_orient(orient):
    with pytest.raises(sdm.MeshError, match="'keep', 'auto' or 'parts'"):
        sdm.signed_distance_map(MESH, GRID, device="cpu", orient=orient)


def test_unchecked_vertices_that_are_not_finite_neither_hang_nor_crash():
    """A batch is not checked, so it must at least come back."""
    batch = np.stack([VERTICES] * 4)
    batch[1] = np.nan
    batch[2, 3] = np.inf
    batch[3, 0, 1] = np.nan
    maps = sdm.signed_distance_maps(batch, FACES, GRID, device="cpu")
    assert torch.equal(maps[0], sdm.signed_distance_map(MESH, GRID, device="cpu").values)
    assert not maps[1].isfinite().any()
