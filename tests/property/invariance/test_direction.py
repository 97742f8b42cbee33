"""Grids that are turned or mirrored, as medical images are: the map is that of the scattered centres."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import cube, load_case
from tests.helpers import oracle, strategies
from tests.helpers.exactness import ROUNDING, scale_of

meshes = st.one_of(strategies.soups(), strategies.closed(), strategies.shells())
axes = [np.eye(3)[list(o)] * s for o in itertools.permutations(range(3)) for s in itertools.product((1, -1), repeat=3)]


def _check(mesh: strategies.Arrays, grid: sdm.Grid, roundings: float) -> None:
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    field = index.signed_distance_map(grid)
    assert field.grid is grid
    centres = grid.points().reshape(-1, 3).numpy()
    limit = roundings * ROUNDING * scale_of(mesh.vertices, mesh.faces, centres)
    expected, _, _ = oracle.distance(mesh.vertices, mesh.faces, centres)
    values = field.numpy().reshape(-1).astype(np.float64)
    assert (np.abs(np.abs(values) - expected) <= limit).all()
    winding = oracle.winding_number(mesh.vertices, mesh.faces, centres)
    sure = (np.abs(winding - 0.5) > 1e-3) & (expected > 100 * limit)
    assert ((values < 0) == (winding > 0.5))[sure].all()
    slabs = torch.cat([part for _, _, part in index.slabs(grid, 2048)])
    assert torch.equal(slabs, field.values)


@settings(max_examples=24)
@given(meshes, st.sampled_from(axes))
def test_axes_in_any_order(mesh, direction):
    """As exact as without a direction: nothing but the order and signs of coordinates changes."""
    origin = direction @ np.array([-3.5, -3.25, -3.0])
    _check(mesh, sdm.Grid(origin, [0.75, 0.5, 1.0], [9, 10, 7], direction), 4)


@settings(max_examples=24)
@given(meshes, strategies.seeds)
def test_any_rotation_or_reflection(mesh, seed):
    rng = np.random.default_rng(seed)
    direction, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    # The mesh is turned, which rounds every vertex once more, and the centres too.
    _check(mesh, sdm.Grid(3 * rng.normal(size=3), [0.7, 0.4, 1.1], [7, 9, 6], direction), 8)


def test_a_mirror_keeps_inside_inside():
    mesh = sdm.TriangleMesh(*cube())
    grid = sdm.Grid([1.5, -1.5, -1.5], [0.5] * 3, [7] * 3, np.diag([-1.0, 1, 1]))
    field = sdm.signed_distance_map(mesh, grid, device="cpu")
    assert field.values[3, 3, 3] == -1
    assert field.values[0, 0, 0] == pytest.approx(0.75**0.5)


@pytest.mark.parametrize("name", ["open hemisphere", "random soup"])
def test_meshes_with_a_boundary(name):
    case = load_case(name)
    direction, _ = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))
    for turn in (direction, -direction):
        grid = sdm.Grid(-turn.sum(1), [0.25] * 3, [9] * 3, turn)
        index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cpu")
        dense, scattered = index.signed_distance_map(grid).values, index.signed_distance(grid.points())
        torch.testing.assert_close(dense.abs(), scattered.abs(), rtol=0, atol=1e-6)
        winding = oracle.winding_number(case.vertices, case.faces, grid.points().reshape(-1, 3).numpy())
        sure = torch.from_numpy(np.abs(winding - 0.5) > 2e-3).reshape(grid.shape) & (dense.abs() > 1e-4)
        assert torch.equal((dense < 0)[sure], (scattered < 0)[sure])


def test_gradients_reach_the_vertices():
    vertices, faces = cube()
    leaf = torch.tensor(vertices, requires_grad=True)
    direction = np.linalg.qr(np.random.default_rng(9).normal(size=(3, 3)))[0]
    origin = [3.0, 0.2, 0.1]
    field = sdm.signed_distance_map(
        sdm.TriangleMesh(leaf, faces), sdm.Grid(origin, [1] * 3, [1] * 3, direction), device="cpu"
    )
    field.values.sum().backward()
    assert leaf.grad is not None
    torch.testing.assert_close(leaf.grad.sum(0), torch.tensor([-1.0, 0, 0]), rtol=0, atol=1e-6)
