"""Scalings, turns and reflections commute with the map: exactly where float32 is exact, else to its rounding."""

from __future__ import annotations

import itertools

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from tests.helpers import oracle, strategies
from tests.helpers.exactness import ROUNDING, scale_of

meshes = st.one_of(strategies.soups(), strategies.closed(), strategies.shells())
turns = st.sampled_from(
    [(o, s) for o in itertools.permutations(range(3)) for s in itertools.product((1, -1), repeat=3)]
)


def _values(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> torch.Tensor:
    return sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, device="cpu")


def _sure(mesh: strategies.Arrays, points: np.ndarray, values: torch.Tensor, margin: float) -> np.ndarray:
    winding = oracle.winding_number(mesh.vertices, mesh.faces, points)
    away = values.abs().numpy() > 8 * ROUNDING * scale_of(mesh.vertices, mesh.faces, points)
    return away & (np.abs(winding - 0.5) > margin)


@settings(max_examples=30)
@given(meshes, strategies.seeds, st.sampled_from([-90, -24, -1, 1, 40, 90]))
def test_powers_of_two_change_no_bit(mesh, seed, power):
    points = strategies.points_about(mesh, seed)
    factor = np.float32(2.0**power)
    plain = _values(mesh.vertices, mesh.faces, points)
    scaled = _values(mesh.vertices * factor, mesh.faces, points * factor)
    # Smaller numbers than these lose bits when they are scaled down.
    whole = plain.abs() > 1e-7
    assert torch.equal((plain * float(factor))[whole], scaled[whole])


@settings(max_examples=20)
@given(meshes, st.sampled_from([-60, 3, 60]))
def test_powers_of_two_change_no_bit_of_a_map(mesh, power):
    factor = 2.0**power
    grid = sdm.Grid([-3.3] * 3, [0.6] * 3, [9, 10, 11])
    larger = sdm.Grid(np.array(grid.origin) * factor, np.array(grid.spacing) * factor, grid.shape)
    plain = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu").values
    scaled = sdm.signed_distance_map(
        sdm.TriangleMesh(mesh.vertices * np.float32(factor), mesh.faces), larger, device="cpu"
    )
    whole = plain.abs() > 1e-7
    assert torch.equal((plain * factor)[whole], scaled.values[whole])


@settings(max_examples=40)
@given(meshes, strategies.seeds, turns)
def test_axes_in_another_order_and_mirrored(mesh, seed, turn):
    order, signs = turn
    points = strategies.points_about(mesh, seed)
    matrix = np.eye(3)[list(order)] * np.array(signs)
    faces = mesh.faces if np.linalg.det(matrix) > 0 else mesh.faces[:, ::-1]
    plain = _values(mesh.vertices, mesh.faces, points)
    turned = _values((mesh.vertices @ matrix).astype(np.float32), faces, (points @ matrix).astype(np.float32))
    limit = 4 * ROUNDING * scale_of(mesh.vertices, mesh.faces, points)
    assert ((plain.abs() - turned.abs()).abs().numpy() <= limit).all()
    sure = _sure(mesh, points, plain, 1e-3)
    assert ((plain < 0) == (turned < 0)).numpy()[sure].all()


@settings(max_examples=30)
@given(meshes, strategies.seeds, st.floats(0.01, 100))
def test_any_turn_and_size(mesh, seed, size):
    rng = np.random.default_rng(seed)
    points = strategies.points_about(mesh, seed)
    matrix, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    faces = mesh.faces if np.linalg.det(matrix) > 0 else mesh.faces[:, ::-1]
    plain = _values(mesh.vertices, mesh.faces, points).double()
    moved = strategies.Arrays((size * mesh.vertices @ matrix).astype(np.float32), faces)
    turned = _values(moved.vertices, moved.faces, size * points @ matrix).double() / size
    # Vertices and points are rounded once more, by sqrt(3) roundings each, at a scale that the turn may make larger.
    # The smallest numbers are rounded to whole multiples of the least one.
    limit = 16 * ROUNDING * scale_of(mesh.vertices, mesh.faces, points) + 16 * 2.0**-149 / min(size, 1.0)
    assert ((plain.abs() - turned.abs()).abs().numpy() <= limit).all()
    # Close to an edge rounding turns the faces seen from there, so the winding number moves with it.
    sure = _sure(mesh, points, plain, 0.05) & (plain.abs().numpy() > 100 * limit)
    assert ((plain < 0) == (turned < 0)).numpy()[sure].all()
