"""Boundary edges that stand twice are taken once, if all do, and signs are those of the sum over all of them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import sheets, turned
from sdm.bench.common.meshes import torus
from sdm.engine.acceleration import build
from sdm.kernels.winding import column_sums
from sdm.kernels.winding.rims import edge_boxes
from sdm.kernels.winding.rims.edges_once import edges_once
from sdm.runtime.torch_warp import workspace


def half_turned() -> tuple[np.ndarray, np.ndarray]:
    return turned(torus(400), 0.5)


def open_as_well() -> tuple[np.ndarray, np.ndarray]:
    """One edge more, which is alone."""
    vertices, faces = half_turned()
    return vertices, np.concatenate([faces, [[0, 1, 2]]]).astype(np.int32)


def structure_of(mesh: tuple[np.ndarray, np.ndarray], batch: int = 1):
    vertices = torch.from_numpy(mesh[0])
    return build(torch.stack([vertices * (1 + k) for k in range(batch)]), torch.from_numpy(mesh[1]))


@pytest.mark.parametrize("batch", [1, 2])
def test_half_as_many_where_all_stand_twice(batch):
    structure = structure_of(half_turned(), batch)
    boundary = structure.view.winding.boundary
    empty = workspace(torch.device("cpu"))
    once, times = edges_once(boundary, batch, empty)
    count = boundary.count
    assert count % 2 == 0
    assert times.numpy().tolist() == [2]
    assert once.counted.numpy().tolist() == [count // 2]
    every = boundary.ends.numpy().reshape(batch, count // 2, 2, 2, 3)
    assert np.array_equal(every[:, :, 0], every[:, :, 1])
    kept = once.ends.numpy().reshape(batch, count, 2, 3)[:, : count // 2]
    assert np.array_equal(kept, every[:, :, 0])


@pytest.mark.parametrize("mesh", [open_as_well(), sheets(3)], ids=["one more", "sheets"])
def test_all_where_one_is_alone(mesh):
    structure = structure_of(mesh)
    boundary = structure.view.winding.boundary
    empty = workspace(torch.device("cpu"))
    once, times = edges_once(boundary, 1, empty)
    assert times.numpy().tolist() == [1]
    assert once.counted.numpy().tolist() == [boundary.count]
    assert np.array_equal(once.ends.numpy(), boundary.ends.numpy())


@pytest.mark.parametrize("parted", [0, np.inf], ids=["larger boxes first", "small boxes"])
@pytest.mark.parametrize("mesh", [half_turned(), open_as_well()], ids=["twice", "one more"])
def test_signs_are_those_of_the_sum_over_all_edges(mesh, parted, monkeypatch):
    """By a GPU's way, where each box looks at edges."""
    given = sdm.TriangleMesh(*mesh, check=False)
    index, grid = sdm.MeshIndex(given, "cpu"), sdm.Grid.around(given, resolution=24)
    monkeypatch.setattr(column_sums, "BY_EIGHTS", False)
    monkeypatch.setattr(column_sums, "FACES_AN_EDGE", {"cpu": (0, np.inf)})
    monkeypatch.setitem(edge_boxes.FEWEST_LARGE, "cpu", parted)
    looked = []
    monkeypatch.setattr(column_sums, "open_edges", lambda *given: looked.append(edge_boxes.open_edges(*given)))
    found = []
    for method in ("caps", "edges"):
        monkeypatch.setattr(column_sums, "OPEN_METHOD", method)
        found.append(index.signed_distance_map(grid))
    assert looked
    assert torch.equal(found[0].values, found[1].values)
    assert found[0].ambiguous_voxels == found[1].ambiguous_voxels
    assert (found[0].values < 0).any()
