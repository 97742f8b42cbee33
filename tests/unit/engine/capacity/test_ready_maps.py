"""First maps by recordings that were used before: the same bits, and the same that is remembered."""

from __future__ import annotations

import threading
from unittest import mock

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import torn
from sdm.bench.common.mesh_formulas import torus
from sdm.bench.common.meshes import Case
from sdm.bench.dense.first import split
from sdm.bench.gpu.first_map_host import as_on_a_gpu
from sdm.engine import api
from sdm.engine.capacity import ready_maps
from sdm.engine.capacity.classes import MOSTS, _decided, bounds_of, stretches
from sdm.engine.plan_override import USUAL, plan_override
from sdm.errors import MeshError
from sdm.runtime import graphs
from sdm.runtime.graphs import captured_call, replay
from sdm.topology import guesses
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.face_pairing import is_known

GRID = sdm.Grid([-1.4] * 3, [0.2] * 3, [15] * 3)


_launches: list[int] = []


class OnTheHost(captured_call.TableRecording):
    """A recording whose launch does its work at once, on a CPU."""

    def __init__(self, pool, work, table):
        self.lock, self._work, self._new_table, self._length = threading.Lock(), work, table.new, table.length

    def launch(self, fill, reads, about=()):
        """The results, once they are there."""
        table = torch.zeros(self._length, dtype=torch.float64)
        results = fill(memoryview(table.numpy()), self._new_table(), *about)
        self._said: list[int] = []

        def verify(flags, told=0, write=None):
            if write is not None:
                flags = torch.empty_like(flags)
                write(flags.data_ptr())
            self._said, self._told_behind = flags.tolist(), told

        self._work(verify, table)
        _launches.append(len(about))
        return results

    def guessed_right(self):
        """Answers by the flags that were told."""
        return not any(self._said[: len(self._said) - self._told_behind]), self._said


@pytest.fixture
def launches(monkeypatch):
    """For each launch how much its table was filled from: nothing of one that was not ready."""
    monkeypatch.setattr(guesses, "last_open", type(guesses.last_open)())
    monkeypatch.setattr(ready_maps, "_ready", {})
    _launches.clear()
    # Undone before what it is put over: else that would stay for all tests of the process.
    with as_on_a_gpu(), mock.patch.object(replay, "TableRecording", OnTheHost):
        yield _launches


def _mesh(vertices, faces):
    arrays = (np.ascontiguousarray(array) for array in (vertices.astype(np.float32), faces.astype(np.int32)))
    return sdm.TriangleMesh(*(torch.from_numpy(array) for array in arrays), check=False)


def _same(mesh):
    found = api._plain_map(mesh, GRID, "cuda")
    expected = sdm.MeshIndex((mesh.vertices, mesh.faces.clone()), "cpu", warn=False).signed_distance_map(GRID)
    assert torch.equal(found.values, expected.values)
    assert found.ambiguous_voxels == expected.ambiguous_voxels
    assert is_known(mesh.faces, len(mesh.vertices))
    edges = boundary_edges(mesh.vertices, mesh.faces.clone())
    assert torch.equal(boundary_edges(mesh.vertices, mesh.faces), edges)


def _splits(number):
    vertices, faces = torus(400)
    case = split(Case("torus", vertices, faces, frozenset()), 3 + number)
    return case.vertices, case.faces


def test_closed_meshes(launches):
    for number in range(3):
        _same(_mesh(*_splits(number)))
    assert [about > 0 for about in launches] == [False, True, True]


def test_open_meshes(launches):
    for number in range(3):
        _same(_mesh(*torn(_splits(number), 0.05)))
    assert [about > 0 for about in launches] == [False, True, True]


def test_open_meshes_of_counts_seen_before(launches):
    vertices, faces = torn(_splits(0), 0.05)
    for number in range(3):
        _same(_mesh(vertices + np.float32(0.001 * number), faces))
    assert [about > 0 for about in launches] == [False, True, True]


def test_many_edges_of_counts_seen_before_go_the_usual_way(launches):
    """Of more edges than faces these are the caps."""
    vertices, faces = _splits(0)
    faces = faces.copy()
    faces[::2] = faces[::2, ::-1]
    for number in range(3):
        _same(_mesh(vertices + np.float32(0.001 * number), faces))
    assert guesses.last_open[len(faces), len(vertices)].boundary > len(faces)
    assert not any(launches)


def test_faces_that_do_not_agree_are_found_out_and_go_on(launches):
    vertices, faces = _splits(0)
    _same(_mesh(vertices, faces))
    faces = faces.copy()
    faces[::3] = faces[::3, ::-1]
    for _ in range(2):
        _same(_mesh(vertices + np.float32(0.001), faces))
        guesses.last_open.clear()
    # By the recording of closed meshes, in vain, and by the next.
    assert [about > 0 for about in launches] == [False, True, False, True, False]


def test_a_vertex_out_of_range_is_refused(launches):
    _same(_mesh(*_splits(0)))
    vertices, faces = _splits(1)
    faces = faces.copy()
    faces[3, 1] = len(vertices)
    with pytest.raises(MeshError, match="uses vertex"):
        api._plain_map(_mesh(vertices, faces), GRID, "cuda")


def test_larger_recordings_serve_until_the_class_is_due(launches, monkeypatch):
    monkeypatch.setattr(graphs, "PATIENCE", 2)
    monkeypatch.setattr(replay, "PATIENCE", 2)
    large = torus(1800)
    _same(_mesh(*large))
    small = [_splits(number) for number in range(6)]
    for mesh in small:
        _same(_mesh(*mesh))
    # The larger one, not ready, ready twice, not ready; then the class has its own.
    assert [about > 0 for about in launches] == [False, False, True, True, False, False, True]


def test_what_is_out_of_the_ordinary_goes_the_usual_way(launches):
    vertices, faces = _splits(0)
    _same(_mesh(vertices, faces))
    del launches[:]
    with plan_override(split_length=1 << 20):
        _same(_mesh(vertices, faces))
    # Turned, and of other spacings.
    for grid in (
        sdm.Grid([-1.4] * 3, [0.2] * 3, [15] * 3, [[0, 1, 0], [1, 0, 0], [0, 0, 1]]),
        sdm.Grid([-1.4] * 3, [0.2, 0.2, 0.25], [15] * 3),
    ):
        api._plain_map(_mesh(vertices, faces), grid, "cuda")
    assert not any(launches)


def test_forgotten_recordings_are_not_asked(launches):
    _same(_mesh(*_splits(0)))
    graphs.clear()
    _same(_mesh(*_splits(1)))
    _same(_mesh(*_splits(2)))
    assert [about > 0 for about in launches] == [False, False, True]


@pytest.mark.parametrize("shape", [(64, 64, 64), (32, 32, 32), (128, 64, 96)])
@pytest.mark.parametrize("gpu", [False, True])
def test_stretches_of_meshes_about_which_the_same_is_decided(shape, gpu):
    rng = np.random.default_rng(0)
    for most in MOSTS[:6]:
        ends, decisions = stretches(most, shape, gpu)
        least, _ = bounds_of(most)
        assert ends[-1] == most
        for faces in (least, most, *rng.integers(least, most, 40).tolist()):
            place = next(place for place, end in enumerate(ends) if faces <= end)
            assert decisions[place] == _decided(faces, shape, gpu, USUAL)
