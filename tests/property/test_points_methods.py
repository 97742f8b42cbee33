"""Both ways to query points, by lists of triangles for packets of points and by one search a point, and hard cases."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import load_case, sphere
from sdm.engine.plan_override import plan_override
from sdm.kernels.points.group_descent import MOST, OWN_ROOM
from sdm.kernels.points.packets import PACKET
from tests.helpers import strategies
from tests.helpers.exactness import assert_exact

METHODS = ["lists", "search"]
DEVICES = ("cpu", "cuda")[: 1 + torch.cuda.is_available()]
meshes = st.one_of(strategies.soups(40), strategies.slivers(), strategies.closed(), strategies.shells())


def clusters(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Clouds of one packet of points each, from much smaller than a triangle to much larger than the mesh."""
    used = vertices[faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = max(float((high - low).max()), 1e-3 * float(np.abs(used).max())) or 1.0
    corner = used[rng.integers(0, len(used), count)]
    on_surface = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), count), corner)
    middle = np.where(rng.random((count, 1)) < 0.5, on_surface, rng.uniform(low - size, high + size, (count, 3)))
    reach = size * 10.0 ** rng.uniform(-6, 0.5, (count, 1, 3))
    return (middle[:, None] + reach * rng.uniform(-1, 1, (count, PACKET, 3))).reshape(-1, 3).astype(np.float32)


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=40)
@given(mesh=strategies.anywhere(meshes), seed=strategies.seeds)
def test_against_the_brute_force(method, mesh, seed):
    points = clusters(np.random.default_rng(seed), mesh.vertices, mesh.faces, 12)
    for device in DEVICES:
        with plan_override(points_method=method):
            values = sdm.signed_distance(sdm.TriangleMesh(*mesh), points, device=device).cpu()
        assert_exact(mesh.vertices, mesh.faces, points, values)


@pytest.mark.parametrize("name", ["nested shells", "needle fan", "random soup", "tiny beside huge", "loose slivers"])
def test_named_meshes(name):
    case = load_case(name)
    points = clusters(np.random.default_rng(1), case.vertices, case.faces, 40)
    for device in DEVICES:
        index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), device)
        signs = []
        for method in METHODS:
            with plan_override(points_method=method):
                values = index.signed_distance(points).cpu()
            assert_exact(case.vertices, case.faces, points, values)
            signs.append(values < 0)
        assert torch.equal(*signs)


@pytest.mark.parametrize("reach", [1e-7, 1e-3, 0.3, 30.0])
def test_lists_that_are_too_long(reach):
    """Around the centre of a sphere all its triangles are as near as each other: too many for a packet, or a point."""
    rng = np.random.default_rng(2)
    for fineness, fewest in ((10, OWN_ROOM), (42, MOST)):
        vertices, faces = sphere(fineness)
        assert len(faces) > fewest
        vertices = (vertices @ np.linalg.qr(rng.normal(size=(3, 3)))[0]).astype(np.float32)
        points = (reach * rng.uniform(-1, 1, (3 * PACKET, 3))).astype(np.float32)
        for device in DEVICES:
            with plan_override(points_method="lists"):
                values = sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, device=device).cpu()
            assert_exact(vertices, faces, points, values)


@pytest.mark.parametrize("method", METHODS)
def test_closest_points(method):
    case = load_case("nested shells")
    points = clusters(np.random.default_rng(3), case.vertices, case.faces, 40)
    points[7] = np.nan
    for device in DEVICES:
        mesh = sdm.TriangleMesh(case.vertices, case.faces)
        with plan_override(points_method=method):
            values, hit = sdm.signed_distance(mesh, points, return_closest=True, device=device)
        corners = torch.from_numpy(case.vertices[case.faces]).double()[hit.faces.cpu().clamp(min=0)]
        at = (corners * hit.barycentric.cpu().double()[..., None]).sum(1)
        scale = torch.from_numpy(np.abs(points).max(1)).double().clamp(min=float(np.abs(case.vertices).max()))
        assert hit.faces[7] == -1
        fine = torch.arange(len(points)) != 7
        assert ((at - hit.points.cpu().double()).norm(dim=1) <= 1e-6 * scale)[fine].all()
        away = (torch.from_numpy(points).double() - at).norm(dim=1)
        assert ((away - values.cpu().double().abs()).abs() <= 1e-6 * scale)[fine].all()
