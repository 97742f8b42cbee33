"""Memory is shared where types and devices allow it, and never written."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
import sdm.engine.ops
from sdm.bench.common.meshes import cube


def test_a_mesh_shares_its_arrays():
    vertices, faces = cube()
    mesh = sdm.TriangleMesh(vertices, faces)
    assert mesh.vertices.data_ptr() == vertices.ctypes.data
    assert mesh.faces.data_ptr() == faces.ctypes.data
    tensors = torch.tensor(vertices), torch.tensor(faces)
    mesh = sdm.TriangleMesh(*tensors)
    assert mesh.vertices is tensors[0]
    assert mesh.faces is tensors[1]
    assert sdm.MeshIndex(mesh, "cpu").mesh.vertices.data_ptr() == tensors[0].data_ptr()


def test_an_update_shares_its_vertices():
    vertices, faces = cube()
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
    moved = torch.tensor(vertices) * 2
    index.update(moved)
    assert index.mesh.vertices.data_ptr() == moved.data_ptr()


@pytest.mark.parametrize("make", [torch.from_numpy, np.asarray], ids=["torch", "numpy"])
def test_points_reach_the_kernel_without_a_copy(monkeypatch, make):
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    seen = []
    plain = sdm.engine.ops._query

    def spy(at, *rest, **named):
        seen.append(at.data_ptr())
        return plain(at, *rest, **named)

    monkeypatch.setattr(sdm.engine.ops, "_query", spy)
    sdm.signed_distance(sdm.TriangleMesh(*cube()), make(points), device="cpu")
    assert seen == [points.ctypes.data]


def test_nothing_given_is_written():
    vertices, faces = cube()
    points = np.random.default_rng(0).normal(size=(6000, 3)).astype(np.float32)
    copies = vertices.copy(), faces.copy(), points.copy()
    mesh = sdm.TriangleMesh(vertices, faces)
    index = sdm.MeshIndex(mesh, "cpu")
    index.signed_distance(points, return_closest=True)
    index.signed_distance_map(sdm.Grid.around(mesh, resolution=9))
    sdm.signed_distance_maps(vertices[None], faces, sdm.Grid.around(mesh, resolution=5), device="cpu")
    index.update(vertices)
    for given, copy in zip((vertices, faces, points), copies, strict=True):
        assert np.array_equal(given, copy)


def test_results_are_the_callers_own():
    """Two calls never share memory; slabs may be kept."""
    index = sdm.MeshIndex(sdm.TriangleMesh(*cube()), "cpu")
    grid = sdm.Grid([0, 0, 0], [0.5] * 3, [4, 4, 4])
    first, second = index.signed_distance_map(grid).values, index.signed_distance_map(grid).values
    assert first.data_ptr() != second.data_ptr()
    kept = list(index.slabs(grid, 64))
    assert torch.equal(torch.cat([values for _, _, values in kept]), first)
    first.fill_(7)
    assert torch.equal(torch.cat([values for _, _, values in kept]), second)
