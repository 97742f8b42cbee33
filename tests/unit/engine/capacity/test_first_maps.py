"""First maps of meshes never seen before: the recording that they go to, and the next if that was wrong."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import torn
from sdm.bench.common.mesh_formulas import torus
from sdm.engine import maps
from sdm.engine.capacity import first_maps
from sdm.engine.capacity.class_calls import class_key
from sdm.engine.capacity.classes import BY_FACES, LARGEST_ROOM, LEAST_FEW, MANY_EDGES, MOST_EDGES, class_of
from sdm.engine.capacity.first_maps import looks_closed
from sdm.errors import MeshError
from sdm.kernels.winding.rims import every_voxel
from sdm.runtime import graphs
from sdm.topology import guesses
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.face_pairing import is_known, pairing_of
from tests.helpers.by_table import by_table

GRID = sdm.Grid([-1.4] * 3, [0.2] * 3, [15] * 3)
CLOSED, OPEN = "class", "open class"


@pytest.fixture
def went(monkeypatch):
    """Attempts, what was noted and what was settled otherwise; `_recorded` says which recordings there are."""
    log: list[str] = []
    monkeypatch.setattr(guesses, "last_open", guesses.last_open.__class__())
    monkeypatch.setattr(maps, "USE_CLASSES", True)

    def attempt(call):
        log.append(call.of.key[0])
        if not graphs.is_recorded(call.of.device, call.of.key):
            log[-1] += " is not there"
            other = call.instead() if call.instead else None
            return (None, []) if other is None else attempt(other)
        found, numbers, told = by_table(call)
        return (None if any(numbers[: len(numbers) - told]) else found), numbers

    monkeypatch.setattr(graphs, "attempt_by_table", attempt)
    monkeypatch.setattr(graphs, "note", lambda call: None)
    monkeypatch.setattr(graphs, "run", lambda call: call.work(graphs.unverified, *call.inputs))

    def speculate(guess, settle):
        log.append("settle")
        return settle()[0], False

    monkeypatch.setattr(graphs, "speculate", speculate)
    return log


def _recorded(monkeypatch, *names):
    rooms = {CLOSED: (0,), OPEN: (MOST_EDGES,)}
    keys = {(name, kind, room) for name in names for room in rooms[name] for kind in _classes()}
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: key in keys)


def _classes():
    return [class_of(200, 100, GRID, None)[0], class_of(200, 600, GRID, None)[0]]


def _open():
    return tuple(torch.from_numpy(array) for array in torn(torus(400), 0.05))


def _closed():
    return tuple(torch.from_numpy(array) for array in torus(400))


def _map(mesh):
    vertices, faces = mesh
    values, ambiguous = maps.mesh_map(vertices, faces, GRID, torch.clone)
    expected = sdm.MeshIndex((vertices, faces.clone()), "cpu", warn=False).signed_distance_map(GRID)
    assert torch.equal(values, expected.values)
    assert (0 if ambiguous is None else ambiguous()) == expected.ambiguous_voxels
    assert is_known(faces, len(vertices))


def test_an_open_mesh_goes_to_the_open_class(went, monkeypatch):
    _recorded(monkeypatch, CLOSED, OPEN)
    mesh = _open()
    _map(mesh)
    assert went == [OPEN]
    fresh = pairing_of(mesh[1].clone(), len(mesh[0]))
    known = pairing_of(mesh[1], len(mesh[0]))
    assert torch.equal(known.neighbours, fresh.neighbours)
    assert sorted(known.unmatched.tolist()) == sorted(fresh.unmatched.tolist())
    # Again, with what was remembered.
    _map(mesh)


def test_a_closed_mesh_goes_to_its_class(went, monkeypatch):
    _recorded(monkeypatch, CLOSED, OPEN)
    _map(_closed())
    assert went == [CLOSED]


def test_the_open_class_serves_closed_ones_until_theirs_is_there(went, monkeypatch):
    _recorded(monkeypatch, OPEN)
    _map(_closed())
    assert went == ["class is not there", OPEN]


def test_no_open_class_is_made_for_a_closed_mesh_whose_class_is_not_due(went, monkeypatch):
    _recorded(monkeypatch)
    _map(_closed())
    assert went == ["class is not there", "settle"]


def test_an_open_mesh_that_looks_closed_goes_on_to_the_open_class(went, monkeypatch):
    _recorded(monkeypatch, CLOSED, OPEN)
    vertices, faces = _closed()
    torn_ = faces.clone()
    torn_[5] = torn_[6]
    _map((vertices, torn_))
    assert went == [CLOSED, OPEN]


def test_without_a_class_for_open_meshes(went, monkeypatch):
    _recorded(monkeypatch, CLOSED)
    _map(_open())
    assert went == ["open class is not there", "settle"]


def test_what_has_no_room_is_settled_and_not_tried_again(went, monkeypatch):
    _recorded(monkeypatch, CLOSED, OPEN)
    vertices, faces = torus(12_000)
    soup = torch.from_numpy(vertices[faces].reshape(-1, 3) * np.float32(1.0))
    soup[::7] += 0.01
    loose = torch.arange(len(soup), dtype=torch.int32).reshape(-1, 3)
    kind, _ = class_of(len(loose), len(soup), GRID, None)
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: key == class_key(kind, LARGEST_ROOM))
    _map((soup, loose))
    assert went == [OPEN, "settle"]
    _map((soup, loose.clone()))
    assert went == [OPEN, "settle", "settle"]


@pytest.fixture
def rooms(monkeypatch):
    """Room for edges of the calls that are tried, one after the other."""
    found = []
    plain = first_maps.class_call
    monkeypatch.setattr(
        first_maps,
        "class_call",
        lambda kind, decisions, given, room, *more: found.append(room) or plain(kind, decisions, given, room, *more),
    )
    return found


def test_a_mesh_with_many_edges_goes_to_a_class_with_room_for_them(went, rooms, monkeypatch):
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: True)
    vertices, faces = (torch.from_numpy(array) for array in torus(3000))
    torn_up = faces[::2].contiguous()
    assert MOST_EDGES < len(boundary_edges(vertices, torn_up.clone())) <= MANY_EDGES
    expected = sdm.MeshIndex((vertices, torn_up.clone()), "cpu", warn=False).signed_distance_map(GRID)
    values, ambiguous = maps.mesh_map(vertices, torn_up, GRID, torch.clone)
    assert torch.equal(values, expected.values)
    assert ambiguous() == expected.ambiguous_voxels
    assert rooms[-1] == MANY_EDGES
    assert "settle" not in went


def test_faces_that_do_not_agree_are_their_own_caps(went, rooms, monkeypatch):
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: True)
    vertices, faces = _closed()
    faces[::3] = faces[::3].flip(1)
    assert len(faces) < len(boundary_edges(vertices, faces.clone()))
    _map((vertices, faces))
    assert rooms == [0, BY_FACES[0]]
    # Again, with what was remembered.
    _map((vertices, faces))
    assert len(rooms) == 2


def test_boxes_look_closed():
    assert looks_closed(12 * 64, 8 * 64)
    assert not looks_closed(12 * 64 + 4, 8 * 64 + 2)


def test_a_vertex_out_of_range_is_refused(went, monkeypatch):
    for names in ((CLOSED,), (OPEN,), (CLOSED, OPEN)):
        _recorded(monkeypatch, *names)
        for vertices, faces in (_open(), _closed()):
            faces[3, 1] = len(vertices)
            with pytest.raises(MeshError, match="uses vertex"):
                maps.mesh_map(vertices, faces, GRID, torch.clone)


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_a_mesh_with_few_edges_goes_to_a_class_without_caps_first(went, monkeypatch, share):
    monkeypatch.setitem(every_voxel.MOST_SUMS, "cpu", LEAST_FEW * GRID.size)
    few = []
    plain = first_maps.class_call
    monkeypatch.setattr(
        first_maps,
        "class_call",
        lambda kind, decisions, given, room, *more: few.append(room) or plain(kind, decisions, given, room, *more),
    )
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: True)
    mesh = tuple(torch.from_numpy(array) for array in torn(torus(400), share))
    edges = len(boundary_edges(mesh[0], mesh[1].clone()))
    assert 2 * len(mesh[0]) - len(mesh[1]) <= LEAST_FEW
    _map(mesh)
    assert few == ([LEAST_FEW] if edges <= LEAST_FEW else [LEAST_FEW, MOST_EDGES])
    assert went == len(few) * [OPEN]


def test_a_mesh_that_is_closed_after_all_has_few_edges(went, monkeypatch):
    monkeypatch.setitem(every_voxel.MOST_SUMS, "cpu", LEAST_FEW * GRID.size)
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: True)
    vertices, faces = _closed()
    _map((torch.cat([vertices, vertices[:1]]), faces))
    assert went == [OPEN]


@pytest.mark.parametrize("mesh", [_open, _closed])
def test_a_larger_class_serves_until_the_own_one_is_there(went, monkeypatch, mesh):
    found = class_of(2000, 1000, GRID, None)
    assert found is not None
    larger = found[0]
    assert larger is not class_of(400, 200, GRID, None)[0]
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: key[1] is larger)
    _map(mesh())
    name = OPEN if mesh is _open else CLOSED
    assert went == [f"{name} is not there", name]


@pytest.mark.parametrize(
    ("faces", "vertices", "closed"),
    [
        (12, 8, True),
        (400, 200, True),
        (4000, 1980, True),
        (399, 200, False),
        (400, 240, False),
        (562, 299, False),
        # A hole of four edges.
        (270, 138, False),
    ],
)
def test_guess_by_counts(faces, vertices, closed):
    assert looks_closed(faces, vertices) == closed
