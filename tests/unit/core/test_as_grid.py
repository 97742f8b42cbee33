"""A resolution in place of a grid: the grid of the mesh."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube

VERTICES, FACES = cube()
# Twice as long along x.
MESH = sdm.TriangleMesh(VERTICES * np.array([2, 1, 1], np.float32), FACES)
AROUND = sdm.Grid.around(MESH, resolution=9)


def test_calls_take_a_resolution():
    assert sdm.signed_distance_map(MESH, 9, device="cpu").grid == AROUND
    assert sdm.signed_distance_map(MESH, resolution=9, device="cpu").grid == AROUND
    wide = sdm.signed_distance_map(MESH, resolution=9, margin=0.5, device="cpu").grid
    assert wide == sdm.Grid.around(MESH, resolution=9, margin=0.5)
    assert sdm.signed_distance_map(MESH, 9, margin=0.5, device="cpu").grid == wide
    index = sdm.MeshIndex(MESH, "cpu")
    assert index.signed_distance_map(9).grid == AROUND
    assert next(index.slabs(9))[2].shape == (9, 9, 9)


def test_batches_take_a_resolution():
    batch = torch.stack([MESH.vertices, 3 * MESH.vertices])
    found = sdm.signed_distance_maps(batch, FACES, 9, device="cpu")
    grid = sdm.Grid.around(sdm.TriangleMesh(3 * MESH.vertices, FACES), 9)
    assert torch.equal(found, sdm.signed_distance_maps(batch, FACES, grid, device="cpu"))
    assert torch.equal(found, sdm.signed_distance_maps(batch, FACES, resolution=9, device="cpu"))


def test_meshes_that_differ():
    grids = [AROUND, sdm.Grid.around(MESH, 5)]
    found = sdm.signed_distance_maps([MESH, MESH], grids, device="cpu")
    assert [field.grid for field in found] == grids
    assert [field.shape for field in sdm.signed_distance_maps([MESH, MESH], 5, device="cpu")] == [(5, 5, 5)] * 2
    assert sdm.signed_distance_maps([MESH], resolution=5, device="cpu")[0].grid == grids[1]
    with pytest.raises(sdm.GridError, match="3 meshes and 2 grids"):
        sdm.signed_distance_maps([MESH] * 3, grids, device="cpu")


def test_three_numbers_are_voxels_along_each_axis():
    grid = sdm.Grid.around(MESH, (21, 11, 11), margin=0)
    np.testing.assert_allclose(grid.spacing, 0.2)
    np.testing.assert_allclose(grid.origin, (-2, -1, -1))
    # The axis with the least room decides.
    tight = sdm.Grid.around(MESH, (21, 6, 11), margin=0)
    np.testing.assert_allclose(tight.spacing, 0.4)
    np.testing.assert_allclose(tight.origin, (-4, -1, -2))


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (None, "a map needs a grid: give a Grid, a number of voxels"),
        (MESH, "TriangleMesh is no grid"),
        (0, "resolution 0 must be a whole number"),
        (2.5, "resolution 2.5 must be a whole number"),
        ((4, 4), "or three, one for each axis"),
        ((4, 4, 0), "or three, one for each axis"),
    ],
)
def test_what_is_no_grid(grid, message):
    calls = [
        lambda: sdm.signed_distance_map(MESH, grid, device="cpu"),
        lambda: sdm.MeshIndex(MESH, "cpu").signed_distance_map(grid),
        lambda: sdm.signed_distance_maps(MESH.vertices[None], FACES, grid, device="cpu"),
        lambda: sdm.signed_distance_maps([MESH], grid, device="cpu"),
    ]
    for call in calls:
        with pytest.raises(sdm.GridError, match=message):
            call()


def test_a_grid_and_a_resolution_contradict():
    with pytest.raises(sdm.GridError, match="a grid or a resolution, not both"):
        sdm.signed_distance_map(MESH, AROUND, resolution=9, device="cpu")
    with pytest.raises(sdm.GridError, match="give the grid alone"):
        sdm.signed_distance_map(MESH, AROUND, margin=0.1, device="cpu")
