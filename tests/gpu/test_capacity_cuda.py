"""First calls on a GPU, replayed from recordings with room for many sizes: the bits of calls that are not replayed."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.bench.dense.first import fresh, split
from sdm.engine import maps
from sdm.errors import MeshError
from sdm.runtime import graphs

pytestmark = pytest.mark.gpu


@pytest.fixture(autouse=True)
def afresh(monkeypatch):
    monkeypatch.setattr(maps, "USE_CLASSES", True)
    graphs.clear()
    yield
    graphs.clear()


def _grid(case, number, shape, direction=None):
    low, high = case.box
    step = (high - low).max() / (max(shape) - 3) * (1 + 0.01 * number)
    given = {} if direction is None else {"direction": direction}
    return sdm.Grid(low - (0.5 + 0.1 * number) * step, [step] * 3, shape, **given)


def _expected(mesh, grid):
    with graphs.paused():
        return sdm.MeshIndex(mesh, warn=False).signed_distance_map(grid).values


@pytest.mark.parametrize("name", ["torus-1000", "torus-20000", "nested shells", "zero-area faces", "needle box"])
@pytest.mark.parametrize("shape", [(64, 64, 64), (40, 33, 90)])
def test_the_same_bits_whatever_the_counts_and_grids(launches, name, shape):
    case = load_case(name)
    for number in range(8):
        other = split(case, 2 + number)
        grid = _grid(other, number, shape)
        found = sdm.signed_distance_map(fresh(other, "cuda"), grid)
        assert torch.equal(found.values, _expected(fresh(other, "cuda"), grid))
        assert found.ambiguous_voxels == 0
    assert len(launches) == 8 - graphs.CALLS


def test_turned_grids(launches):
    case = load_case("torus-1000")
    for number in range(6):
        grid = _grid(case, number, (30, 30, 30), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        found = sdm.signed_distance_map(fresh(case, "cuda"), grid)
        assert torch.equal(found.values, _expected(fresh(case, "cuda"), grid))
    assert len(launches) == 6 - graphs.CALLS


def test_an_open_mesh_between_closed_ones_leaves_the_recording(launches):
    case = load_case("torus-5000")
    grid = _grid(case, 0, (48, 48, 48))
    for number in range(10):
        other = split(case, 2 + number)
        mesh = fresh(other, "cuda")
        if number in (5, 7):
            mesh = sdm.TriangleMesh(mesh.vertices, mesh.faces[number:].contiguous(), check=False)
        found = sdm.signed_distance_map(mesh, grid)
        assert torch.equal(found.values, _expected(mesh, grid))
    # Of the open ones too, in vain.
    assert len(launches) == 10 - graphs.CALLS


def test_faces_are_known_afterwards_and_right(launches):
    case = load_case("torus-5000")
    grid = _grid(case, 0, (48, 48, 48))
    for number in range(6):
        mesh = fresh(split(case, 2 + number), "cuda")
        sdm.signed_distance_map(mesh, grid)
        moved = sdm.TriangleMesh(1.1 * mesh.vertices, mesh.faces, check=False)
        again = sdm.TriangleMesh(1.1 * mesh.vertices, mesh.faces.clone(), check=False)
        assert torch.equal(sdm.signed_distance_map(moved, grid).values, _expected(again, grid))


def test_a_face_out_of_range_is_refused(launches):
    case = load_case("torus-5000")
    grid = _grid(case, 0, (48, 48, 48))
    for number in range(6):
        mesh = fresh(split(case, 2 + number), "cuda")
        if number == 4:
            mesh.faces[number, 1] = len(mesh.vertices)
            with pytest.raises(MeshError, match="uses vertex"):
                sdm.signed_distance_map(mesh, grid)
        else:
            sdm.signed_distance_map(mesh, grid)


def test_streams(launches):
    case = load_case("torus-20000")
    grid = _grid(case, 0, (64, 64, 64))
    meshes = [fresh(split(case, 2 + number), "cuda") for number in range(12)]
    expected = [_expected(mesh, grid) for mesh in (fresh(split(case, 2 + number), "cuda") for number in range(12))]
    streams = [torch.cuda.Stream() for _ in range(3)]
    torch.cuda.synchronize()
    found = []
    for number, mesh in enumerate(meshes):
        with torch.cuda.stream(streams[number % 3]):
            found.append(sdm.signed_distance_map(mesh, grid).values)
    torch.cuda.synchronize()
    assert all(torch.equal(ours, theirs) for ours, theirs in zip(found, expected, strict=True))
