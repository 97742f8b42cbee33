"""Which calls are recorded, how many recordings are kept, and that a CPU has none of it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case, sphere
from sdm.engine import maps
from sdm.runtime import cuda_graphs
from sdm.runtime.captured_call import Held, Room
from sdm.runtime.graph_cache import MOST_CALLS, MOST_KINDS, WELL_WORTH, WORTH, Shelf
from sdm.topology import boundary_edges

INPUTS = (torch.zeros(1),)


class Stub:
    """A recording that takes some memory of its room."""

    def __init__(self, room, work, inputs):
        room.nbytes += work


@pytest.fixture
def shelf():
    return Shelf(100, Stub)


def _note(shelf, kind, nbytes=10, times=cuda_graphs.CALLS):
    for _ in range(times):
        shelf.note(kind, nbytes, INPUTS)


def test_faces_are_copied_again_once_they_changed_or_another_recording_was_launched():
    room = Room()
    one, other = Held(room, 2), Held(room, 2)
    faces, again = torch.zeros(4, 3, dtype=torch.int32), torch.zeros(4, 3, dtype=torch.int32)

    def launched(held, *given):
        """Which inputs were there already."""
        held.begin()
        found = [held.has(place, tensor) for place, tensor in enumerate(given)]
        for place, tensor in enumerate(given):
            held.note(place, tensor)
        return found

    moving = torch.zeros(5, 3)
    assert launched(one, moving, faces) == [False, False]
    assert launched(one, moving, faces) == [False, True]
    assert launched(one, moving, again) == [False, False]
    assert launched(one, moving, again) == [False, True]
    again[0] = 1
    assert launched(one, moving, again) == [False, False]
    # Its scratch may have been where the inputs of the first lie.
    assert launched(other, moving, faces) == [False, False]
    assert launched(one, moving, again) == [False, False]
    assert launched(one, moving, again) == [False, True]
    with torch.inference_mode():
        uncounted = torch.zeros(4, 3, dtype=torch.int32)
    assert [launched(one, moving, uncounted) for _ in range(2)] == [[False, False]] * 2


def test_the_third_call_is_recorded(shelf):
    _note(shelf, "a", times=2)
    assert shelf.find("a") is None
    shelf.note("a", 10, INPUTS)
    assert isinstance(shelf.find("a"), Stub)
    assert shelf.find("b") is None


def test_kinds_are_counted_apart(shelf):
    for _ in range(2):
        for kind in ("a", "b", "c"):
            shelf.note(kind, 10, INPUTS)
    assert len(shelf) == 0


def test_the_least_recently_used_goes(shelf):
    for kind in "abcd":
        _note(shelf, kind)
        for _ in range(WORTH):
            shelf.find(kind)
    shelf.find("a")
    _note(shelf, "e")
    assert [kind for kind in "abcde" if shelf.find(kind)] == ["a", "c", "d", "e"]
    # What went has to come three times again.
    _note(shelf, "b", times=2)
    assert shelf.find("b") is None
    shelf.note("b", 10, INPUTS)
    assert shelf.find("b") is not None


def test_kinds_by_turns_are_not_recorded_again_and_again(shelf):
    made = []
    shelf._record = lambda *args: made.append(1) or Stub(*args)
    for _ in range(MOST_CALLS):
        for kind in range(20):
            if shelf.find(kind) is None:
                shelf.note(kind, 1, INPUTS)
    assert shelf.needed >= 16 * cuda_graphs.CALLS
    # Without a limit it would be one for each three calls.
    assert len(made) < 20 * 10
    # One that stays is recorded all the same, and its use makes the next ones be recorded as soon as the first.
    _note(shelf, "stays", times=MOST_CALLS)
    for _ in range(WELL_WORTH):
        assert shelf.find("stays") is not None
    assert shelf.needed == cuda_graphs.CALLS


def test_one_kind_after_the_other(shelf):
    """As in a benchmark: each is used some times and never again, so that none has to wait for longer."""
    for kind in range(20):
        _note(shelf, kind, 1)
        for _ in range(WORTH):
            assert shelf.find(kind) is not None


def test_forgetting(shelf):
    for kind in range(9):
        _note(shelf, kind, 1, times=MOST_CALLS)
    assert shelf.needed > cuda_graphs.CALLS
    _note(shelf, "a", times=cuda_graphs.CALLS - 1)
    shelf.forget()
    assert len(shelf) == 0
    _note(shelf, "a", times=cuda_graphs.CALLS - 1)
    assert shelf.find("a") is None
    _note(shelf, "a", times=1)
    assert shelf.find("a") is not None


def test_too_much_memory_is_given_back(shelf):
    _note(shelf, "a", 60)
    for _ in range(WORTH):
        shelf.find("a")
    _note(shelf, "b", 60)
    assert len(shelf) == 0
    _note(shelf, "b", 60)
    assert len(shelf) == 1
    # This one was not worth it.
    _note(shelf, "a", 60)
    assert len(shelf) == 0
    _note(shelf, "a", 60)
    assert len(shelf) == 0
    _note(shelf, "a", 60)
    assert len(shelf) == 1


def test_one_that_is_too_large_is_never_recorded_again(shelf):
    made = []
    shelf._record = lambda *args: made.append(1) or Stub(*args)
    _note(shelf, "a", 101, times=20)
    assert len(shelf) == 0
    assert len(made) == 1


def test_a_failure_is_told_once_and_does_no_harm(shelf):
    def fail(*args):
        raise RuntimeError("no")

    shelf._record = fail
    with pytest.warns(UserWarning, match="could not be recorded"):
        _note(shelf, "a")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _note(shelf, "a", times=20)
    assert len(shelf) == 0


def test_counts_do_not_pile_up(shelf):
    for kind in range(1000):
        shelf.note(kind, 10, INPUTS)
    assert len(shelf._calls) <= MOST_KINDS


def test_a_wrong_guess_is_dropped(shelf):
    _note(shelf, "a")
    shelf.drop("a")
    shelf.drop("never there")
    assert len(shelf) == 0
    assert shelf._room.nbytes == 0


def test_a_cpu_never_enters(monkeypatch):
    def never(*args):
        raise AssertionError("a CPU's call was to be replayed")

    for name in ("replayed", "note"):
        monkeypatch.setattr(cuda_graphs, name, never)
    case = load_case("torus-500")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    grid = sdm.Grid.around(mesh, resolution=6)
    for _ in range(4):
        values = sdm.signed_distance_map(mesh, grid, device="cpu").values
        batch = sdm.signed_distance_maps(mesh.vertices[None], mesh.faces, grid, device="cpu")
        assert torch.equal(values, batch[0])


def test_the_switch():
    assert cuda_graphs._switch.on
    assert cuda_graphs._switch.pauses == 0
    # By turns, as two threads would: the first to end leaves the other's pause alone.
    one, other = cuda_graphs.paused(), cuda_graphs.paused()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert cuda_graphs._switch.pauses == 1
    other.__exit__(None, None, None)
    assert cuda_graphs._switch.on
    assert cuda_graphs._switch.pauses == 0
    cuda_graphs.enable(False)
    try:
        assert not cuda_graphs.serves(INPUTS[0])
    finally:
        cuda_graphs.enable(True)
    cuda_graphs.clear()


@pytest.mark.parametrize("name", ["torus-500", "open hemisphere", "random soup", "unmerged sphere"])
def test_what_is_recorded_gives_the_same_bits(monkeypatch, name):
    """The functions that a GPU records, run here without a recording."""
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    grid = sdm.Grid.around(mesh, resolution=10)
    index = sdm.MeshIndex(mesh, "cpu")
    expected = index.signed_distance_map(grid)
    noted = []
    monkeypatch.setattr(cuda_graphs, "note", lambda kind, work, inputs: noted.append((kind, work, inputs)))
    monkeypatch.setattr(cuda_graphs, "serves", lambda tensor: True)
    # New faces first, then known ones.
    faces = mesh.faces.clone()
    for _ in range(2):
        values, ambiguous = maps.map_of(mesh.vertices, faces, grid)
        assert torch.equal(values, expected.values)
        assert (ambiguous is None) == index.closed
        assert (0 if ambiguous is None else int(ambiguous)) == expected.ambiguous_voxels
    assert torch.equal(maps.batch_maps(mesh.vertices[None], faces, grid, None)[0], expected.values)
    first = {"torus-500": "closed", "open hemisphere": "open"}.get(name, "known")
    assert [kind[0] for kind, _, _ in noted] == [first, "known", "known"]
    for _, work, inputs in noted:
        said = []
        assert torch.equal(work(said.append, *inputs)[0][0], expected.values)
        assert not any(remarks.any() for remarks in said)


def test_a_wrong_guess_is_told():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    grid = sdm.Grid([-1] * 3, [0.5] * 3, [4] * 3)
    for wrong in (faces[1:].contiguous(), torch.where(faces == 3, 10_000, faces), torch.where(faces == 3, -5, faces)):
        said = []
        maps._closed_map(grid, said.append, vertices, wrong.int())
        assert said[0].any()


def test_a_wrong_guess_of_an_open_mesh_is_told():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    count, grid = vertices.shape[0], sdm.Grid([-1] * 3, [0.5] * 3, [4] * 3)
    torn = faces[1:].contiguous()
    edges = boundary_edges.boundary_edges(vertices, torn)
    boundary_edges.remember_open(torn, count, edges)
    numbers = boundary_edges.guess(torn.clone(), count)
    assert numbers == (3, 3)
    assert boundary_edges.guess(faces, count) is None
    said = []
    maps._open_map(numbers, grid, said.append, vertices, torn)
    assert not said[0].any()
    twice, flipped = torn.clone(), torn.clone()
    twice[3] = twice[5]
    flipped[4] = flipped[4].flip(0)
    for wrong in (twice, flipped, torch.where(torn == 3, 10_000, torn), torch.where(torn == 3, -5, torn)):
        said = []
        maps._open_map(numbers, grid, said.append, vertices, wrong.int().contiguous())
        assert said[0].any()
    # A closed one of as many faces.
    boundary_edges.remember_open(torn, count, edges[:0])
    assert boundary_edges.guess(torn, count) is None


def test_closed_faces_are_remembered():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    count = vertices.shape[0]
    assert not boundary_edges.is_known(faces, count)
    expected = boundary_edges.neighbours(faces, count)
    assert boundary_edges.is_known(faces, count)
    assert not boundary_edges.is_known(faces, count + 1)
    other = faces.clone()
    boundary_edges.remember_closed(other, count, expected)
    assert boundary_edges.is_known(other, count)
    assert boundary_edges.boundary_edges(vertices, other).shape == (0, 2)
    other[0] = other[1]
    assert not boundary_edges.is_known(other, count)
    assert np.array_equal(
        boundary_edges.boundary_edges(vertices, other), boundary_edges.boundary_edges(vertices, other.clone())
    )
