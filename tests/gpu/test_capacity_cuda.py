"""First calls on a GPU, replayed from recordings with room for many sizes: the bits of calls that are not replayed."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import half_spheres, sheets, torn
from sdm.bench.common.mesh_formulas import torus
from sdm.bench.common.meshes import Case, load_case
from sdm.bench.dense.first import fresh, split
from sdm.engine import maps
from sdm.errors import MeshError
from sdm.runtime import graphs
from sdm.runtime.graphs import graph_cache
from sdm.runtime.graphs.captured_call import TableRecording
from sdm.topology import guesses
from sdm.topology.face_pairing import pairing_of

pytestmark = pytest.mark.gpu


@pytest.fixture(autouse=True)
def afresh(monkeypatch):
    monkeypatch.setattr(maps, "USE_CLASSES", True)
    guesses.last_open.clear()
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
    assert len(launches) == 8


def _arrays(case):
    return case.vertices, case.faces


def _dirt(name, number):
    """Meshes with other counts for each number, vertices and faces."""
    case = split(load_case("torus-5000"), 2 + number)
    mesh = _arrays(case)
    if name == "half spheres":
        # Of more, the vertices are for another class.
        return half_spheres(4 + min(number, 5))
    if name == "sheets":
        return sheets(20 + number)
    if name == "flipped":
        vertices, faces = torus(800 + 10 * number)
        some = np.random.default_rng(number).random(len(faces)) < 0.5
        return vertices, np.where(some[:, None], faces[:, [0, 2, 1]], faces)
    if name == "equal positions":
        vertices, faces = torn(mesh, 0.02)
        own, faces = np.random.default_rng(number).random(len(faces)) < 0.05, faces.copy()
        twice = vertices[faces[own, 0]]
        faces[own, 0] = len(vertices) + np.arange(own.sum())
        return np.concatenate([vertices, twice]), faces
    return torn(mesh, {"torn": 0.01, "torn much": 0.08}[name])


OPEN = ["torn", "torn much", "half spheres", "sheets", "flipped", "equal positions"]


@pytest.mark.parametrize("name", OPEN)
@pytest.mark.parametrize("direction", [None, [[0, 1, 0], [1, 0, 0], [0, 0, 1]]])
def test_open_meshes_have_the_same_bits(launches, name, direction):
    for number in range(7):
        vertices, faces = _dirt(name, number)
        case = Case(name, vertices.astype(np.float32), faces.astype(np.int32), frozenset())
        grid = _grid(case, number, (48, 40, 56), direction)
        found = sdm.signed_distance_map(fresh(case, "cuda"), grid)
        with graphs.paused():
            expected = sdm.MeshIndex(fresh(case, "cuda"), warn=False).signed_distance_map(grid)
        assert torch.equal(found.values, expected.values)
        assert found.ambiguous_voxels == expected.ambiguous_voxels > 0
    # Some look closed, and go to that class first.
    assert 7 <= len(launches) <= 14


def test_open_and_closed_meshes_by_turns(launches):
    """Both recordings, guesses that are wrong, and what is known afterwards."""
    case = load_case("torus-5000")
    for number in range(16):
        other = split(case, 2 + number)
        vertices, faces = other.vertices, other.faces
        if number % 2:
            # One with as many faces as a closed mesh would have.
            vertices, faces = torn((vertices, faces), 0.01) if number % 4 == 1 else (vertices, faces.copy())
            faces[5] = faces[6]
        case_ = Case("", vertices, faces, frozenset())
        grid, mesh = _grid(case_, number, (48, 48, 48)), fresh(case_, "cuda")
        with graphs.paused():
            expected = sdm.MeshIndex(fresh(case_, "cuda"), warn=False).signed_distance_map(grid)
        for again in range(3):
            moved = sdm.TriangleMesh(mesh.vertices.clone() if again else mesh.vertices, mesh.faces, check=False)
            found = sdm.signed_distance_map(moved, grid)
            assert torch.equal(found.values, expected.values)
            assert found.ambiguous_voxels == expected.ambiguous_voxels
    assert launches.count(TableRecording) >= 16


def test_meshes_without_room_for_their_boundary(launches):
    """The class says so, and the map is made otherwise."""
    for number in range(7):
        share = 0.4 if number == 5 else 0.01
        vertices, faces = torn(_arrays(split(load_case("torus-5000"), 2 + number)), share)
        case = Case("", vertices, faces, frozenset())
        grid = _grid(case, number, (48, 48, 48))
        found = sdm.signed_distance_map(fresh(case, "cuda"), grid)
        assert torch.equal(found.values, _expected(fresh(case, "cuda"), grid))


def test_known_open_meshes_that_move_do_not_wait_for_their_vertices(launches):
    vertices, faces = torn(_arrays(load_case("torus-5000")), 0.01)
    case = Case("", vertices, faces, frozenset())
    grid, mesh = _grid(case, 0, (48, 48, 48)), fresh(case, "cuda")
    for step in range(8):
        moved = sdm.TriangleMesh((1 - 0.02 * step) * mesh.vertices, mesh.faces, check=False)
        found = sdm.signed_distance_map(moved, grid)
        again = sdm.TriangleMesh(moved.vertices.clone(), mesh.faces.clone(), check=False)
        assert torch.equal(found.values, _expected(again, grid))
    # The first by its class.
    assert len(launches) == 8 - graphs.CALLS
    # Two ends of a hole come together.
    unmatched = pairing_of(mesh.faces, len(mesh.vertices)).unmatched
    closer = mesh.vertices.clone()
    closer[int(unmatched[0, 0])] = closer[int(unmatched[0, 1])]
    found = sdm.signed_distance_map(sdm.TriangleMesh(closer, mesh.faces, check=False), grid)
    assert torch.equal(found.values, _expected(sdm.TriangleMesh(closer, mesh.faces.clone(), check=False), grid))


def test_turned_grids(launches):
    case = load_case("torus-1000")
    for number in range(6):
        grid = _grid(case, number, (30, 30, 30), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        found = sdm.signed_distance_map(fresh(case, "cuda"), grid)
        assert torch.equal(found.values, _expected(fresh(case, "cuda"), grid))
    assert len(launches) == 6


@pytest.mark.parametrize("share", [0.0, 0.02])
def test_turned_grids_of_meshes_that_lie_elsewhere(launches, share):
    """Rays at voxels ask for the boxes of this mesh's tree, not for those of the last one, which lie elsewhere."""
    rng = np.random.default_rng(0)
    for number in range(30):
        vertices, faces = torus(300 + 8 * number)
        turn, direction = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
        vertices = rng.uniform(0.2, 3) * vertices @ turn + 4 * rng.normal(size=3)
        mesh = sdm.TriangleMesh(vertices.astype(np.float32), faces[rng.random(len(faces)) >= share])
        size = 1.3 * np.ptp(vertices, axis=0).max()
        origin = vertices.mean(axis=0) - direction @ np.full(3, size / 2)
        grid = sdm.Grid(origin, [size / 15] * 3, (16, 16, 16), direction=direction)
        found = sdm.signed_distance_map(mesh.to("cuda"), grid)
        assert torch.equal(found.values, _expected(mesh.to("cuda"), grid))
    assert len(launches) >= 30


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
    # Of the open ones twice.
    assert 10 <= len(launches) <= 12


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


def test_a_class_that_made_room_too_often_waits_for_more_calls(launches, monkeypatch):
    monkeypatch.setattr(graph_cache, "_NEEDED", {False: graphs.CALLS, True: 2})
    graphs.clear()
    case = load_case("torus-1000")
    for number in range(4):
        other = split(case, 2 + number)
        grid = _grid(other, number, (40, 40, 40))
        found = sdm.signed_distance_map(fresh(other, "cuda"), grid)
        assert torch.equal(found.values, _expected(fresh(other, "cuda"), grid))
    assert len(launches) == 3


def test_a_recording_is_made_without_the_work_by_hand_where_that_was_done(launches):
    """Of another size, and then of another grid: whatever is loaded on first use."""
    for size, shape in ((1000, (40, 40, 40)), (20000, (40, 40, 40)), (60000, (96, 96, 96)), (5000, (96, 100, 130))):
        for share in (0, 0.01):
            case = load_case(f"torus-{size}")
            vertices, faces = torn(_arrays(case), share) if share else _arrays(case)
            made = Case("", vertices, faces, frozenset())
            found = sdm.signed_distance_map(fresh(made, "cuda"), _grid(made, 1, shape))
            assert torch.equal(found.values, _expected(fresh(made, "cuda"), _grid(made, 1, shape)))
    assert len(launches) >= 8


def test_arrays_that_are_not_contiguous(launches):
    case = load_case("torus-1000")
    mesh, grid = fresh(case, "cuda"), _grid(case, 0, (40, 40, 40))
    wide, tall = torch.cat([mesh.vertices, mesh.vertices], 1), torch.cat([mesh.faces, mesh.faces], 1)
    found = sdm.signed_distance_map(sdm.TriangleMesh(wide[:, :3], tall[:, 3:], check=False), grid)
    assert torch.equal(found.values, _expected(mesh, grid))
    assert len(launches) == 1


def test_batches_of_open_meshes_that_move(launches):
    vertices, faces = torn(_arrays(load_case("torus-5000")), 0.01)
    batch, faces = torch.tensor(np.stack([vertices, 0.9 * vertices])).cuda(), torch.tensor(faces).cuda()
    grid = sdm.Grid([-1.4] * 3, [0.07] * 3, [40] * 3)
    for step in range(6):
        moved = (1 - 0.03 * step) * batch
        found = sdm.signed_distance_maps(moved, faces, grid)
        with graphs.paused():
            assert torch.equal(found, sdm.signed_distance_maps(moved, faces, grid))
    assert len(launches) == 6 - graphs.CALLS
