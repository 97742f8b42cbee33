"""Recording of calls, the number of recordings kept, and a CPU, which has none of it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case, sphere
from sdm.engine import maps
from sdm.runtime import graphs
from sdm.runtime.graphs import replay
from sdm.runtime.graphs.graph_cache import CALLS_OF_MANY, MOST_CALLS, MOST_KEYS, WELL_WORTH, WORTH, GraphCache
from sdm.topology import face_pairing, guesses
from sdm.topology.boundary_edges import boundary_edges

INPUTS = (torch.zeros(1),)


class Stub:
    """A recording that takes some memory of its pool."""

    def __init__(self, pool, work, inputs):
        pool.nbytes += work


@pytest.fixture
def cache():
    return GraphCache(100, Stub)


def _note(cache, key, nbytes=10, times=graphs.CALLS):
    for _ in range(times):
        cache.count(key, nbytes, INPUTS)


def test_a_recording_for_many_is_made_at_once(cache):
    made = []
    assert cache.find("a") is None
    cache.count("a", 10, INPUTS, for_many=True, capture=lambda *args: made.append(1) or Stub(*args))
    assert isinstance(cache.find("a"), Stub)
    assert len(made) == 1


def test_a_recording_for_many_that_is_large_waits_for_another_call(cache):
    cache.count("a", 10, INPUTS, for_many=True, later=1)
    assert cache.find("a") is None
    cache.count("a", 10, INPUTS, for_many=True, later=1)
    assert isinstance(cache.find("a"), Stub)


def test_recordings_for_many_stay_whatever_comes_for_one_kind(cache):
    """As of a folder of meshes, each asked about often enough: the next mesh's first call needs its class."""
    for key in range(20):
        _note(cache, key, 1)
        if key == 0:
            for _ in range(CALLS_OF_MANY):
                cache.count("class", 1, INPUTS, for_many=True)
    assert cache.find("class") is not None
    # Those used too little have made the others wait, but not the next class.
    assert cache.needed > graphs.CALLS
    for number in range(4):
        for _ in range(CALLS_OF_MANY):
            cache.count(("class", number), 1, INPUTS, for_many=True)
        assert cache.find(("class", number)) is not None
    # They make room among themselves.
    assert cache.find("class") is None


def test_more_may_be_kept_for_many_than_for_one_kind():
    cache = GraphCache(1000, Stub, recordings=2, of_many=5)
    for number in range(5):
        cache.count(("many", number), 10, INPUTS, for_many=True)
        _note(cache, ("one", number), times=MOST_CALLS)
    kept = sorted(cache._captured)
    assert kept == [*(("many", number) for number in range(5)), ("one", 3), ("one", 4)]


def test_the_third_call_is_recorded(cache):
    _note(cache, "a", times=2)
    assert cache.find("a") is None
    cache.count("a", 10, INPUTS)
    assert isinstance(cache.find("a"), Stub)
    assert cache.find("b") is None


def test_keys_are_counted_apart(cache):
    for _ in range(2):
        for key in ("a", "b", "c"):
            cache.count(key, 10, INPUTS)
    assert len(cache) == 0


def test_the_least_recently_used_goes(cache):
    for key in "abcd":
        _note(cache, key)
        for _ in range(WORTH):
            cache.find(key)
    cache.find("a")
    _note(cache, "e")
    assert [key for key in "abcde" if cache.find(key)] == ["a", "c", "d", "e"]
    # What went has to come three times again.
    _note(cache, "b", times=2)
    assert cache.find("b") is None
    cache.count("b", 10, INPUTS)
    assert cache.find("b") is not None


def test_keys_by_turns_are_not_recorded_again_and_again(cache):
    made = []
    cache._capture = lambda *args: made.append(1) or Stub(*args)
    for _ in range(MOST_CALLS):
        for key in range(20):
            if cache.find(key) is None:
                cache.count(key, 1, INPUTS)
    assert cache.needed >= 16 * graphs.CALLS
    # Without a limit it would be one for each three calls.
    assert len(made) < 20 * 10
    # One that stays is recorded all the same, and its use makes the next ones be recorded as soon as the first.
    _note(cache, "stays", times=MOST_CALLS)
    for _ in range(WELL_WORTH):
        assert cache.find("stays") is not None
    assert cache.needed == graphs.CALLS


def test_one_key_after_the_other(cache):
    """As in a benchmark: each is used some times and never again, so that none has to wait for longer."""
    for key in range(20):
        _note(cache, key, 1)
        for _ in range(WORTH):
            assert cache.find(key) is not None


def test_forgetting(cache):
    for key in range(9):
        _note(cache, key, 1, times=MOST_CALLS)
    assert cache.needed > graphs.CALLS
    _note(cache, "a", times=graphs.CALLS - 1)
    cache.reset()
    assert len(cache) == 0
    _note(cache, "a", times=graphs.CALLS - 1)
    assert cache.find("a") is None
    _note(cache, "a", times=1)
    assert cache.find("a") is not None


def test_too_much_memory_is_given_back(cache):
    _note(cache, "a", 60)
    for _ in range(WORTH):
        cache.find("a")
    _note(cache, "b", 60)
    assert len(cache) == 0
    _note(cache, "b", 60)
    assert len(cache) == 1
    # This one was not worth it.
    _note(cache, "a", 60)
    assert len(cache) == 0
    _note(cache, "a", 60)
    assert len(cache) == 0
    _note(cache, "a", 60)
    assert len(cache) == 1


def test_one_that_is_too_large_is_never_recorded_again(cache):
    made = []
    cache._capture = lambda *args: made.append(1) or Stub(*args)
    _note(cache, "a", 101, times=20)
    assert len(cache) == 0
    assert len(made) == 1


def test_a_failure_is_told_once_and_does_no_harm(cache):
    def fail(*args):
        raise RuntimeError("no")

    cache._capture = fail
    with pytest.warns(UserWarning, match="could not be recorded"):
        _note(cache, "a")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _note(cache, "a", times=20)
    assert len(cache) == 0


def test_counts_do_not_pile_up(cache):
    for key in range(1000):
        cache.count(key, 10, INPUTS)
    assert len(cache._calls) <= MOST_KEYS


def test_a_wrong_guess_is_dropped(cache):
    _note(cache, "a")
    cache.drop("a")
    cache.drop("never there")
    assert len(cache) == 0
    assert cache._pool.nbytes == 0


def test_a_cpu_never_enters(monkeypatch):
    def never(*args):
        raise AssertionError("a CPU's call was to be replayed")

    for name in ("replay", "record"):
        monkeypatch.setattr(replay, name, never)
    case = load_case("torus-500")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    grid = sdm.Grid.around(mesh, resolution=6)
    for _ in range(4):
        values = sdm.signed_distance_map(mesh, grid, device="cpu").values
        batch = sdm.signed_distance_maps(mesh.vertices[None], mesh.faces, grid, device="cpu")
        assert torch.equal(values, batch[0])


def test_the_switch():
    assert replay._switch.on
    assert replay._switch.pauses == 0
    # By turns, as two threads would: the first to end leaves the other's pause alone.
    one, other = graphs.paused(), graphs.paused()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert replay._switch.pauses == 1
    other.__exit__(None, None, None)
    assert replay._switch.on
    assert replay._switch.pauses == 0
    graphs.enable(False)
    try:
        assert not graphs.supports(INPUTS[0])
    finally:
        graphs.enable(True)
    graphs.clear()


@pytest.mark.parametrize("name", ["torus-500", "open hemisphere", "random soup", "unmerged sphere"])
def test_what_is_recorded_gives_the_same_bits(monkeypatch, name):
    """The functions that a GPU records, run here without a recording."""
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    grid = sdm.Grid.around(mesh, resolution=10)
    index = sdm.MeshIndex(mesh, "cpu")
    expected = index.signed_distance_map(grid)
    noted, tried = [], []
    monkeypatch.setattr(guesses, "last_open", guesses.last_open.__class__())
    monkeypatch.setattr(replay, "record", noted.append)
    monkeypatch.setattr(graphs, "attempt_by_table", lambda call: tried.append(call) or (None, []))
    monkeypatch.setattr(graphs, "is_recorded", lambda device, key: False)
    monkeypatch.setattr(maps, "is_recordable", lambda vertices, nbytes: True)
    monkeypatch.setattr(maps, "USE_CLASSES", True)
    # New faces first, then known ones.
    faces = mesh.faces.clone()
    for _ in range(2):
        values, ambiguous = maps.mesh_map(mesh.vertices, faces, grid, torch.clone)
        assert torch.equal(values, expected.values)
        assert (ambiguous is None) == index.closed
        assert (0 if ambiguous is None else ambiguous()) == expected.ambiguous_voxels
    assert torch.equal(maps.batch_maps(mesh.vertices[None], faces, grid, None)[0], expected.values)
    assert torch.equal(maps.index_map(index._structure, grid)[0], expected.values)
    # The last two have more unmatched edges than are compared with each other.
    ways = {"torus-500": ("class", [], "known"), "open hemisphere": ("open class", [], "unmoved")}
    by_class, first, second = ways.get(name, ("open class", ["known"], "known"))
    assert [call.of.key[0] for call in tried] == [by_class]
    assert [call.key[0] for call in noted] == [*first, second, second, "index"]
    for call in noted:
        flags = []
        found = call.work(lambda said, told=0: flags.append(said[: len(said) - told]), *call.inputs)  # noqa: B023
        assert torch.equal(found[0][0], expected.values)
        assert not any(found.any() for found in flags)
        assert bool(flags) == (call.key[0] == "unmoved")


def test_a_wrong_guess_is_told():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    grid = sdm.Grid([-1] * 3, [0.5] * 3, [4] * 3)
    for wrong in (faces[1:].contiguous(), torch.where(faces == 3, 10_000, faces), torch.where(faces == 3, -5, faces)):
        flags = []
        maps._queue_guessed_map(guesses.CLOSED, grid, flags.append, vertices, wrong.int())
        assert flags[0].any()


def test_a_wrong_guess_of_an_open_mesh_is_told():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    count, grid = vertices.shape[0], sdm.Grid([-1] * 3, [0.5] * 3, [4] * 3)
    torn = faces[1:].contiguous()
    edges = boundary_edges(vertices, torn)
    guesses.remember(torn, count, edges)
    numbers = guesses.guess(torn.clone(), count)
    assert numbers == (3, 3)
    assert guesses.guess(faces, count) == guesses.CLOSED
    flags = []
    maps._queue_guessed_map(numbers, grid, flags.append, vertices, torn)
    assert not flags[0].any()
    twice, flipped = torn.clone(), torn.clone()
    twice[3] = twice[5]
    flipped[4] = flipped[4].flip(0)
    for wrong in (twice, flipped, torch.where(torn == 3, 10_000, torn), torch.where(torn == 3, -5, torn)):
        flags = []
        maps._queue_guessed_map(numbers, grid, flags.append, vertices, wrong.int().contiguous())
        assert flags[0].any()
    # A closed one of as many faces.
    guesses.remember(torn, count, edges[:0])
    assert guesses.guess(torn, count) == guesses.CLOSED


def test_closed_faces_are_remembered():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    count = vertices.shape[0]
    assert not face_pairing.is_known(faces, count)
    expected = face_pairing.neighbours(faces, count)
    assert face_pairing.is_known(faces, count)
    assert not face_pairing.is_known(faces, count + 1)
    other = faces.clone()
    face_pairing.remember_closed(other, count, expected)
    assert face_pairing.is_known(other, count)
    assert boundary_edges(vertices, other).shape == (0, 2)
    other[0] = other[1]
    assert not face_pairing.is_known(other, count)
    assert np.array_equal(boundary_edges(vertices, other), boundary_edges(vertices, other.clone()))


class TableStub(replay.TableRecording):
    """A recording by table that notes its launches."""

    def __init__(self, pool, work, table):
        self.lock, self.launches = replay.threading.Lock(), 0

    def launch(self, fill, reads):
        """The results, without a launch."""
        self.launches += 1
        return fill(None, ())

    def guessed_right(self):
        """As if nothing was guessed."""
        return True, [self.launches]


@pytest.fixture
def tables(monkeypatch, cache):
    """A cache of `TableStub`s, in place of a GPU's."""
    monkeypatch.setattr(replay, "TableRecording", TableStub)
    monkeypatch.setattr(replay, "_cache_of", lambda device: cache)
    monkeypatch.setitem(replay._caches, torch.device("cpu"), cache)
    cache._pool.nbytes = 0
    return cache


def _table_call(key, **more):
    work, device = (lambda verify, table: None), torch.device("cpu")
    return graphs.TableCall(graphs.TableWork(key, work, device, 1, "family", tuple), lambda table, new: key, (), **more)


def test_another_recording_serves_until_a_call_came_often(tables):
    graphs.attempt_by_table(_table_call("large"))
    asked = []

    def call():
        return _table_call("small", instead=lambda: asked.append(1) or _table_call("large"))

    for _ in range(replay.PATIENCE):
        assert graphs.attempt_by_table(call())[0] == "large"
        assert "small" not in tables
    for _ in range(2):
        assert graphs.attempt_by_table(call())[0] == "small"
    assert len(asked) == replay.PATIENCE + 1


def test_without_another_recording_the_first_call_is_recorded(tables):
    assert graphs.attempt_by_table(_table_call("small", instead=lambda: None)) == ("small", [1])


def test_results_are_made_of_what_was_filled(tables):
    assert graphs.attempt_by_table(_table_call("a", launched=lambda filled: filled + "b"))[0] == "ab"
