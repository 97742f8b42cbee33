"""The map of shells that stand apart is the least of their maps; that of a shell in a shell turns nothing over."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import cube, sphere
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING

GRID = sdm.Grid([-6, -3, -3], [0.75, 0.5, 0.5], [17, 13, 13])

LIMIT = 8 * ROUNDING * 7  # two maps, 7 away from the origin at most


def _map(*meshes: strategies.Arrays) -> torch.Tensor:
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)])
    mesh = sdm.TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), faces)
    return sdm.signed_distance_map(mesh, GRID, device="cpu").values


def _moved(mesh: strategies.Arrays, x: float) -> strategies.Arrays:
    return strategies.Arrays(mesh.vertices + np.array([x, 0, 0], np.float32), mesh.faces)


@settings(max_examples=24)
@given(strategies.closed(), st.sampled_from([cube(0.5), sphere(5)]))
def test_apart(left, right):
    left, right = _moved(left, -4), _moved(strategies.Arrays(*right), 4)
    both, least = _map(left, right), torch.minimum(_map(left), _map(right))
    assert (both - least).abs().max() <= LIMIT
    off = least.abs() > LIMIT
    assert torch.equal((both < 0)[off], (least < 0)[off])


def test_a_shell_within_a_shell_is_inside_too():
    outer, inner = strategies.Arrays(*cube(2.0)), strategies.Arrays(*cube(1.0))
    both = _map(outer, inner)
    off = both.abs() > LIMIT
    assert torch.equal((both < 0)[off], (_map(outer) < 0)[off])
    least = torch.minimum(_map(outer).abs(), _map(inner).abs())
    torch.testing.assert_close(both.abs(), least, rtol=0, atol=LIMIT)


def test_an_inverted_shell_within_a_shell_is_a_hole():
    outer, inner = strategies.Arrays(*cube(2.0)), strategies.Arrays(cube(1.0)[0], cube(1.0)[1][:, ::-1])
    expected = torch.maximum(_map(outer), -_map(strategies.Arrays(*cube(1.0))))
    both = _map(outer, inner)
    torch.testing.assert_close(both.abs(), expected.abs(), rtol=0, atol=LIMIT)
    off = expected.abs() > LIMIT
    assert torch.equal((both < 0)[off], (expected < 0)[off])
