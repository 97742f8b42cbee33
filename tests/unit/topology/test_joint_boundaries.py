"""Boundary edges of meshes that differ, found together: those of each by itself, by whichever way."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere, torus
from sdm.topology import device_joining, joint_boundaries
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.cap_triangles import cap_triangles
from sdm.topology.face_pairing import PairingUnderWay, pairing_of


def some_meshes() -> list[sdm.TriangleMesh]:
    """Closed and open ones, two of them at one place, one whose triangles share no vertices and one twice over."""
    rng = np.random.default_rng(4)
    ball, faces = sphere(12)
    ring, around = torus(300)
    loose = ball[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    arrays = [
        cube(),
        (ball, faces[3:]),
        (ball, faces[1:]),
        loose,
        (loose[0], loose[1][5:]),
        (ring, around[rng.random(len(around)) > 0.2]),
        (ring, around[7:]),
        (ring, np.concatenate([around[:9], around[:9]])),
        (ring, around),
    ]
    return [sdm.TriangleMesh(*pair) for pair in arrays]


@pytest.fixture(params=["host", "torch", "compared", "tables"])
def way(request, monkeypatch):
    if request.param == "torch":
        monkeypatch.setattr(joint_boundaries, "MOST_ON_HOST", 0)
    elif request.param != "host":
        monkeypatch.setattr(device_joining, "JOINING_DEVICES", ("cpu",))
        if request.param == "tables":
            monkeypatch.setattr("sdm.kernels.topology.boundary_loops.MOST_COMPARED", 0)
    return request.param


def test_as_each_by_itself(way):
    meshes = some_meshes()
    counts = [mesh.vertices.shape[0] for mesh in meshes]
    firsts = np.cumsum([0, *counts])
    faces = torch.cat([mesh.faces + int(first) for mesh, first in zip(meshes, firsts, strict=False)])
    vertices = torch.cat([mesh.vertices for mesh in meshes])
    under_way = PairingUnderWay(faces, len(vertices))
    unmatched = under_way.finish().unmatched
    counts = torch.tensor(counts, dtype=torch.int32)
    found = joint_boundaries.joint_boundaries(unmatched, under_way.found, vertices, counts)
    assert found.edges.dtype == torch.int32
    assert len(found.edges) == found.begins[-1] == sum(found.counts)
    caps = joint_boundaries.caps_of(found.edges, len(vertices))
    for i, (mesh, first) in enumerate(zip(meshes, firsts, strict=False)):
        alone = boundary_edges(mesh.vertices, mesh.faces)
        assert torch.equal(found.of_some([i]) - int(first), alone), i
        own = caps[found.begins[i] : found.begins[i + 1]] - int(first)
        if way in ("compared", "tables") and len(alone):
            # A device cuts loops that meet in its own way.
            alone = device_joining.boundary_on_device(pairing_of(mesh.faces, len(mesh.vertices)), mesh.vertices)
        assert torch.equal(own, cap_triangles(alone)), i
        closed = torch.cat([mesh.faces, own])
        assert len(boundary_edges(mesh.vertices, closed)) == 0
    assert [bool(count) for count in found.counts] == [False, True, True, False, True, True, True, True, False]


@pytest.mark.usefixtures("way")
def test_edges_that_come_many_times_over():
    # Copies of a sheet leave each of its edges as often.
    sheet = sdm.TriangleMesh(*torus(60)).faces[:20].repeat(5, 1)
    vertices = sdm.TriangleMesh(*torus(60)).vertices
    under_way = PairingUnderWay(sheet, len(vertices))
    counts = torch.tensor([len(vertices)], dtype=torch.int32)
    found = joint_boundaries.joint_boundaries(under_way.finish().unmatched, under_way.found, vertices, counts)
    assert torch.equal(found.edges, boundary_edges(vertices, sheet.clone()))
    assert found.begins == [0, len(found.edges)]
