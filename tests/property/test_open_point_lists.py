"""Points of random lists of open meshes of every kind, on the surface too: bit for bit those of single calls."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.engine.plan_override import plan_override
from sdm.engine.structure import sizes
from sdm.topology.boundary_edges import boundary_edges
from tests.helpers.same_bits import assert_same_bits
from tests.property.test_ragged_lists import assert_same_closest, random_mesh

# Limits between kinds, so that small meshes are of each.
KINDS = [
    {"MOST_BOUNDARY_EDGES": sizes.MOST_BOUNDARY_EDGES},
    {"MOST_BOUNDARY_EDGES": 30, "FEWEST_FACES_AN_EDGE": 1},
    {"MOST_BOUNDARY_EDGES": 8},
    {"MOST_BOUNDARY_EDGES": 8, "MOST_FOR_VOXELS": 60},
]


def torn_mesh(rng: np.random.Generator) -> sdm.TriangleMesh:
    """A random mesh, of which some faces are missing."""
    mesh = random_mesh(rng)
    faces = mesh.faces[torch.from_numpy(rng.random(len(mesh)) > rng.choice([0.02, 0.1, 0.4]))]
    return sdm.TriangleMesh(mesh.vertices, faces if len(faces) else mesh.faces[:1])


def kinds_of(meshes: list[sdm.TriangleMesh]) -> list[str]:
    """Names of the kinds of meshes, by the limits of now."""
    return [sizes.kind_of(len(boundary_edges(mesh.vertices, mesh.faces)), len(mesh)).name for mesh in meshes]


def points_around(rng: np.random.Generator, mesh: sdm.TriangleMesh, count: int, *, on_it: bool) -> torch.Tensor:
    """Points about a mesh's box, half of them in clusters, on its device, and with `on_it` some at vertices and in
    triangles.
    """
    low, high = mesh.bounds
    size = high - low + 1e-3
    away = rng.normal(size=(count, 3)) * 0.6 * size + 0.5 * (low + high)
    # Packets of such are small beside their distance from holes.
    middles = rng.uniform(low, high, (8, 3))[rng.integers(8, size=count)]
    away = np.where(rng.random((count, 1)) < 0.5, middles + rng.normal(size=(count, 3)) * 0.01 * size, away)
    points = torch.from_numpy(away.astype(np.float32)).to(mesh.device)
    if on_it and count:
        which = torch.from_numpy(rng.random(count) < 0.05).to(mesh.device)
        corners = torch.from_numpy(rng.integers(0, len(mesh.vertices), count)).to(mesh.device)
        points = torch.where(which[:, None], mesh.vertices[corners], points)
        which = torch.from_numpy(rng.random(count) < 0.05).to(mesh.device)
        faces = mesh.faces[torch.from_numpy(rng.integers(0, len(mesh), count)).to(mesh.device)].long()
        points = torch.where(which[:, None], mesh.vertices[faces].mean(1), points)
    if count:
        points[rng.integers(count)] = torch.nan
    return points


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    limits=st.sampled_from(KINDS),
    closest=st.booleans(),
    method=st.sampled_from(["search", "lists"]),
    many=st.sampled_from([60, 600, 3000]),
    max_bytes=st.sampled_from([None, 1 << 21]),
)
def test_points_are_those_of_single_calls(seed, limits, closest, method, many, max_bytes):
    rng = np.random.default_rng(seed)
    with mock.patch.multiple(sizes, **limits), plan_override(points_method=method):
        meshes = [(torn_mesh if rng.random() < 0.8 else random_mesh)(rng) for _ in range(rng.integers(2, 7))]
        points = [points_around(rng, mesh, int(rng.integers(0, many)), on_it=True) for mesh in meshes]
        asked = {"device": "cpu", "return_closest": closest}
        found = sdm.signed_distances(meshes, points, max_bytes=max_bytes, **asked)
        for i, (made, mesh, at) in enumerate(zip(found, meshes, points, strict=True)):
            alone = sdm.signed_distance(mesh, at, **asked)
            values, own = (made[0], alone[0]) if closest else (made, alone)
            assert_same_bits(values, own, (i, mesh, kinds_of([mesh])))
            if closest:
                assert_same_closest(made[1], alone[1], mesh.vertices, (i, mesh))
