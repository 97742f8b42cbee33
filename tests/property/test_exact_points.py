"""Scattered points: exact distances and right signs on every kind of small mesh."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from tests.helpers import strategies
from tests.helpers.exactness import assert_exact

meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())


@settings(max_examples=120)
@given(strategies.anywhere(meshes), strategies.seeds)
def test_points_equal_the_brute_force(mesh, seed):
    points = strategies.points_about(mesh, seed)
    values = sdm.signed_distance(sdm.TriangleMesh(*mesh), points, device="cpu")
    assert values.dtype == torch.float32
    assert_exact(mesh.vertices, mesh.faces, points, values)
