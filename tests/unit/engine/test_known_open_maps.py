"""Maps of open meshes that come again: the host does not look at their vertices, and what has changed is noticed."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import torn
from sdm.bench.common.mesh_formulas import torus
from sdm.engine import maps
from sdm.runtime import graphs
from sdm.topology import boundary_edges
from sdm.topology.face_pairing import pairing_of

GRID = sdm.Grid([-1.4] * 3, [0.2] * 3, [15] * 3)


@pytest.fixture
def way(monkeypatch):
    """The ways that maps went: `attempt` of a recording that was right or wrong, `run`, `note`."""
    went, noted = [], set()

    def attempt(call):
        if call.key not in noted:
            return None, []
        flags = []
        found = call.work(flags.append, *call.inputs)
        went.append("wrong" if flags[0].any() else "right")
        return (None if flags[0].any() else found), flags[0].tolist()

    monkeypatch.setattr(graphs, "attempt", attempt)
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: key in noted)
    monkeypatch.setattr(graphs, "note", lambda call: noted.add(call.key) or went.append("note"))
    monkeypatch.setattr(graphs, "run", lambda call: went.append("run") or call.work(graphs.unverified, *call.inputs))
    return went


def _expected(vertices, faces):
    return sdm.MeshIndex((vertices.clone(), faces.clone()), "cpu", warn=False).signed_distance_map(GRID)


def test_the_host_looks_once_at_an_open_mesh(way, monkeypatch):
    vertices, faces = (torch.from_numpy(array) for array in torn(torus(400), 0.1))
    boundary_edges.boundary_edges(vertices, faces)
    looks = []
    plain = boundary_edges.joined_on_host
    monkeypatch.setattr(boundary_edges, "joined_on_host", lambda *args: looks.append(1) or plain(*args))
    for factor in (1.0, 1.1, 0.9):
        expected = _expected(factor * vertices, faces)
        before = len(looks)
        values, ambiguous = maps.mesh_map(factor * vertices, faces, GRID, torch.clone)
        assert torch.equal(values, expected.values)
        assert ambiguous() == expected.ambiguous_voxels
        assert len(looks) == before + (factor == 1.0)
    assert way == ["note", "right", "right"]


@pytest.mark.parametrize("back", [False, True])
def test_ends_that_come_together_or_part_are_noticed(way, back):
    """A closed torus cut along nothing but indices: its boundary is where its vertices are apart."""
    given, index = torus(200)
    loose = given[index].reshape(-1, 3)
    faces = torch.arange(len(loose), dtype=torch.int32).reshape(-1, 3)
    closed = torch.from_numpy(loose.copy())
    apart = closed.clone()
    apart[:30] += torch.tensor([0.0, 0.01, 0.02])
    order = [apart, closed, apart] if back else [closed, apart, closed]
    boundary_edges.boundary_edges(order[0], faces)
    for vertices in (order[0], *order):
        values, ambiguous = maps.mesh_map(vertices, faces, GRID, torch.clone)
        expected = _expected(vertices, faces)
        assert torch.equal(values, expected.values)
        assert (0 if ambiguous is None else ambiguous()) == expected.ambiguous_voxels
    assert way[:3] == ["note", "right", "wrong"]


def test_minus_zero_is_zero(way):
    vertices, faces = (array.copy() for array in torn(torus(200), 0.1))
    vertices -= vertices[faces[0, 0]]
    vertices = np.concatenate([vertices, vertices[faces[0, :1]]])
    faces[0, 0] = len(vertices) - 1
    vertices, faces = torch.from_numpy(vertices), torch.from_numpy(faces)
    boundary_edges.boundary_edges(vertices, faces)
    maps.mesh_map(vertices, faces, GRID, torch.clone)
    vertices[-1] = -vertices[-1]
    assert torch.equal(maps.mesh_map(vertices, faces, GRID, torch.clone)[0], _expected(vertices, faces).values)
    assert way == ["note", "right"]


def _batch(monkeypatch, moved, faces):
    with monkeypatch.context() as patch:
        patch.setattr(maps, "is_recordable", lambda vertices, nbytes: True)
        return maps.batch_maps(moved, faces, GRID, None)


def test_batches(way, monkeypatch):
    vertices, faces = (torch.from_numpy(array) for array in torn(torus(400), 0.1))
    batch = torch.stack([vertices, 0.9 * vertices, 1.1 * vertices])
    for moved in (batch, 0.95 * batch, batch[:2], batch[:2]):
        found = _batch(monkeypatch, moved, faces)
        assert torch.equal(found, torch.stack([_expected(one, faces).values for one in moved]))
    assert way == ["note", "right", "note", "right"]
    # Ends that are at one place in one mesh of a batch alone are not one.
    ends = pairing_of(faces, len(vertices)).unmatched[0, :2].long()
    for many, says in ((1, "right"), (2, "wrong")):
        moved = batch[:2].clone()
        moved[:many, ends[0]] = moved[:many, ends[1]]
        before = len(way)
        found = _batch(monkeypatch, moved, faces)
        assert torch.equal(found[1], _expected(moved[1], faces).values)
        assert way[before:] == {"right": ["right"], "wrong": ["wrong", "run"]}[says]
