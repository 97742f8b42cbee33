"""A closed mesh inside out has winding number -1 within: all is outside, until orient="auto" turns it."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import cube, load_case, sphere
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, scale_of

GRID = sdm.Grid([-3.1] * 3, [0.55] * 3, [12] * 3)


@settings(max_examples=24)
@given(st.one_of(strategies.closed(), strategies.shells(), strategies.soups()), strategies.seeds)
def test_winding_numbers_change_their_sign(mesh, seed):
    points = strategies.points_about(mesh, seed)
    plain = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    flipped = sdm.MeshIndex(sdm.TriangleMesh(*mesh).flipped(), "cpu")
    distance = plain.signed_distance(points).abs()
    limit = torch.from_numpy(8 * ROUNDING * scale_of(mesh.vertices, mesh.faces, points))
    assert ((distance - flipped.signed_distance(points).abs()).abs() <= limit).all()
    off = distance > 1e-5 * max(1.0, float(np.abs(points).max()))
    difference = plain.winding_number(points) + flipped.winding_number(points)
    torch.testing.assert_close(difference[off], torch.zeros_like(difference[off]), atol=2e-3, rtol=0)


def test_all_is_outside():
    vertices, faces = cube(2.0)
    field = sdm.signed_distance_map(sdm.TriangleMesh(vertices, faces[:, ::-1]), GRID, device="cpu")
    assert (field.values >= 0).all()
    assert field.values.max() > 1


def test_orient_auto_turns_it():
    mesh = sdm.TriangleMesh(*sphere(8, 2.0))
    plain = sdm.signed_distance_map(mesh, GRID, device="cpu").values
    assert (plain < 0).any()
    turned = sdm.signed_distance_map(mesh.flipped(), GRID, device="cpu", orient="auto").values
    torch.testing.assert_close(turned, plain, rtol=0, atol=1e-6)
    kept = sdm.signed_distance_map(mesh, GRID, device="cpu", orient="auto").values
    assert torch.equal(kept, plain)


def test_orient_auto_keeps_a_hollow():
    """An inner shell that faces inward is meant so."""
    case = load_case("hollow sphere")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    kept = sdm.signed_distance_map(mesh, GRID, device="cpu", orient="auto").values
    assert torch.equal(kept, sdm.signed_distance_map(mesh, GRID, device="cpu").values)
