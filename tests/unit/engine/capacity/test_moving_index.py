"""An index whose structure is built by what needs it, as on a GPU: the values of one that is built at once."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.engine import api, maps, mesh_index
from sdm.runtime import graphs

GRID = sdm.Grid([-1.2] * 3, [0.3] * 3, [9] * 3)


@pytest.fixture
def builds(monkeypatch):
    """Builds of a structure by itself, counted; calls go the way of a GPU's, without recordings."""
    counted = []
    plain = mesh_index.build
    monkeypatch.setattr(mesh_index, "build", lambda *args: counted.append(1) or plain(*args))
    monkeypatch.setattr(mesh_index, "moves_without_wait", lambda vertices: True)
    # `api` too: a module that is first imported meanwhile would keep what is put here.
    for module in (mesh_index, maps, api):
        monkeypatch.setattr(module, "is_recordable", lambda vertices, nbytes: True)
    monkeypatch.setattr(graphs, "run", lambda call: call.work(graphs.unverified, *call.inputs))
    return counted


def test_a_map_after_each_move_builds_nothing_by_itself(builds):
    case = load_case("torus-200")
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
    for factor in (0.9, 1.1):
        given = factor * vertices
        index.update(given)
        given.zero_()
        found = index.signed_distance_map(GRID)
        expected = sdm.signed_distance_map((factor * vertices, faces), GRID, device="cpu")
        assert torch.equal(found.values, expected.values)
        assert found.ambiguous_voxels == 0
    assert len(builds) == 1
    points = torch.rand(50, 3)
    expected = sdm.MeshIndex(sdm.TriangleMesh(1.1 * vertices, faces), "cpu").signed_distance(points)
    before = len(builds)
    assert torch.equal(index.signed_distance(points), expected)
    assert torch.equal(index.signed_distance(points), expected)
    assert len(builds) == before + 1


def test_an_open_mesh_is_built_at_once(builds):
    case = load_case("open hemisphere")
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cpu", warn=False)
    index.update(0.9 * case.vertices)
    assert len(builds) == 2
    assert not index.closed
