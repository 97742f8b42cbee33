"""Replayed calls on a GPU: the bits of those that are not, whatever comes after what was recorded."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case, sphere, torus
from sdm.engine import maps
from sdm.engine.plan_override import plan_override
from sdm.runtime import graphs
from sdm.runtime.graphs import graph_cache, replay
from sdm.runtime.graphs.replay import MOST_RECORDINGS

pytestmark = pytest.mark.gpu

GRID = sdm.Grid([-1.2] * 3, [0.08] * 3, [31] * 3)
CALLS = graphs.CALLS


@pytest.fixture(autouse=True)
def afresh(monkeypatch):
    # Those of a class before the fourth call, which they serve, all others after the third.
    monkeypatch.setattr(graph_cache, "_NEEDED", {False: graphs.CALLS, True: graphs.CALLS + 1})
    graphs.clear()
    yield
    graphs.clear()


def _mesh(vertices, faces, check=False) -> sdm.TriangleMesh:
    """A mesh that was never seen before."""
    return sdm.TriangleMesh(torch.tensor(vertices).cuda(), torch.tensor(faces).cuda(), check=check)


def _shapes(vertices, count=6):
    rng = np.random.default_rng(0)
    return [(vertices * rng.uniform(0.6, 1.0, 3)).astype(np.float32) for _ in range(count)]


def _eager(mesh, grid=GRID) -> sdm.SDM:
    with graphs.paused():
        return sdm.MeshIndex(mesh).signed_distance_map(grid)


def _same(found: sdm.SDM, expected: sdm.SDM) -> None:
    assert torch.equal(found.values, expected.values)
    assert found.ambiguous_voxels == expected.ambiguous_voxels


@pytest.mark.parametrize("name", ["torus", "open hemisphere", "random soup", "unmerged sphere", "touching cubes"])
def test_the_same_bits(launches, name):
    case = load_case(name)
    rng = np.random.default_rng(1)
    for vertices in _shapes(case.vertices):
        # Other faces of the same number, too.
        faces = case.faces[rng.permutation(len(case.faces))]
        _same(sdm.signed_distance_map(_mesh(vertices, faces), GRID), _eager(_mesh(vertices, faces)))
    assert len(launches) == 6 - CALLS


def test_known_faces_that_move(launches):
    case = load_case("open hemisphere")
    faces = torch.tensor(case.faces).cuda()
    for vertices in _shapes(case.vertices):
        mesh = sdm.TriangleMesh(torch.tensor(vertices).cuda(), faces)
        _same(sdm.signed_distance_map(mesh, GRID), _eager(mesh))
    # The first call, of faces not known before, is of another kind.
    assert len(launches) == 5 - CALLS


def test_faces_written_into(launches):
    vertices, faces = sphere(8)
    mesh = _mesh(vertices, faces)
    for step in range(6):
        mesh.faces.copy_(torch.tensor(np.roll(faces, step, 0)))
        _same(sdm.signed_distance_map(mesh, GRID), _eager(mesh))


@pytest.mark.parametrize("shape", [(31, 31, 31), (40, 9, 70)])
def test_batches(launches, shape):
    case = load_case("torus")
    grid = sdm.Grid([-1.2] * 3, [0.05] * 3, shape)
    faces = torch.tensor(case.faces).cuda()
    for step in range(6):
        batch = torch.tensor(np.stack(_shapes(case.vertices, 4)) * (1 - 0.1 * step)).float().cuda()
        found = sdm.signed_distance_maps(batch, faces, grid)
        with graphs.paused():
            assert torch.equal(found, sdm.signed_distance_maps(batch, faces, grid))
    assert len(launches) == 6 - CALLS


@pytest.mark.parametrize("triangles", [600, 200_000])
def test_known_faces_by_turns_with_another_recording(launches, triangles):
    """Recordings share their scratch: one may write where the other keeps the faces that it need not copy again."""
    vertices, faces = torus(triangles)
    known = torch.tensor(faces).cuda()
    grids = [sdm.Grid([-1.2] * 3, [0.04] * 3, [61] * 3), GRID]
    moved = [torch.tensor(v).cuda() for v in _shapes(vertices)]

    def calls(grid):
        return [sdm.signed_distance_map(sdm.TriangleMesh(v, known), grid) for v in moved]

    with graphs.paused():
        expected = [calls(grid) for grid in grids]
    for grid in grids:
        calls(grid)
    before = len(launches)
    for step, v in enumerate(moved):
        for grid, wanted in zip(grids, expected, strict=True):
            _same(sdm.signed_distance_map(sdm.TriangleMesh(v, known), grid), wanted[step])
    assert len(launches) == before + 2 * len(moved)


def test_an_open_mesh_where_closed_ones_were(launches):
    vertices, faces = sphere(12)
    for _ in range(CALLS + 1):
        sdm.signed_distance_map(_mesh(vertices, faces), GRID)
    assert len(launches) == 1
    torn = faces.copy()
    torn[5] = torn[6]
    mesh = _mesh(vertices, torn)
    _same(sdm.signed_distance_map(mesh, GRID), _eager(_mesh(vertices, torn)))
    assert len(launches) == 2
    # The closed ones are still right.
    _same(sdm.signed_distance_map(_mesh(vertices, faces), GRID), _eager(_mesh(vertices, faces)))


def test_open_meshes_by_turns_with_others(launches):
    vertices, faces = sphere(12)
    torn = np.delete(faces, 7, 0)
    for hole in (7, 11, 30, 31, 200):
        again = np.delete(faces, hole, 0)
        _same(sdm.signed_distance_map(_mesh(vertices, again), GRID), _eager(_mesh(vertices, again)))
    assert len(launches) == 5 - CALLS
    twice = torn.copy()
    twice[5] = twice[6]
    for other in (twice, torn, faces, torn):
        _same(sdm.signed_distance_map(_mesh(vertices, other), GRID), _eager(_mesh(vertices, other)))


def test_an_index_out_of_range_where_none_was():
    vertices, faces = sphere(12)
    for bad in (len(vertices), 2**31 - 1, -1):
        for _ in range(CALLS + 1):
            sdm.signed_distance_map(_mesh(vertices, faces), GRID)
        wrong = faces.copy()
        wrong[3, 1] = bad
        with pytest.raises(sdm.MeshError, match=f"a face uses vertex {bad}, but"):
            sdm.signed_distance_map(_mesh(vertices, wrong), GRID)
        torch.cuda.synchronize()


def test_different_grids_and_methods(launches, monkeypatch):
    # Recordings for the counts of a mesh: those of a class would replay some of these calls earlier.
    monkeypatch.setattr(maps, "USE_CLASSES", False)
    vertices, faces = torus(600)
    grids = [GRID, sdm.Grid([-1.2] * 3, [0.08] * 3, [31, 31, 30]), sdm.Grid([-1.1] * 3, [0.08] * 3, [31] * 3)]
    turned = [[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]
    grids.append(sdm.Grid([-1.2] * 3, [0.08] * 3, [31] * 3, turned))
    for method in ("cells", "search"):
        # Recordings that make room for others after a single use would make these wait for longer.
        graphs.clear()
        with plan_override(method=method):
            for _ in range(CALLS + 1):
                for grid in grids:
                    _same(sdm.signed_distance_map(_mesh(vertices, faces), grid), _eager(_mesh(vertices, faces), grid))
    assert len(launches) == 2 * len(grids)


def test_results_do_not_alias():
    vertices, faces = torus(600)
    meshes = [_mesh(v, faces) for v in _shapes(vertices, 8)]
    found = [sdm.signed_distance_map(mesh, GRID).values for mesh in meshes]
    found[-1].fill_(7)
    assert len({values.data_ptr() for values in found}) == len(found)
    for values, mesh in zip(found[:-1], meshes[:-1], strict=True):
        assert torch.equal(values, _eager(mesh).values)


def test_two_streams(launches):
    case = load_case("torus")
    faces = torch.tensor(case.faces).cuda()
    batches = [torch.tensor(np.stack([v] * 8)).cuda() for v in _shapes(case.vertices, 12)]
    with graphs.paused():
        expected = [sdm.signed_distance_maps(batch, faces, GRID) for batch in batches]
    for _ in range(CALLS):
        sdm.signed_distance_maps(batches[0], faces, GRID)
    torch.cuda.synchronize()
    streams = [torch.cuda.Stream() for _ in range(3)]
    found = []
    for number, batch in enumerate(batches):
        with torch.cuda.stream(streams[number % 3]):
            torch.cuda._sleep(5_000_000 * (number % 2))
            given = batch.clone()
            found.append(sdm.signed_distance_maps(given, faces, GRID))
            del given
    torch.cuda.synchronize()
    assert len(launches) == len(batches)
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one, other)


def test_an_index_is_recorded(launches):
    case = load_case("open hemisphere")
    indices = [sdm.MeshIndex(_mesh(vertices, case.faces)) for vertices in _shapes(case.vertices)]
    expected = [_eager(index.mesh) for index in indices]
    for _ in range(2):
        for index, wanted in zip(indices, expected, strict=True):
            # The second time nothing is copied.
            _same(index.signed_distance_map(GRID), wanted)
            _same(index.signed_distance_map(GRID), wanted)
    assert len(launches) == 4 * len(indices) - CALLS
    indices[0].update(indices[1].mesh.vertices)
    _same(indices[0].signed_distance_map(GRID), expected[1])


def test_a_mesh_that_may_be_turned_is_recorded(launches):
    vertices, faces = torus(600)
    for _ in range(CALLS + 2):
        mesh = _mesh(vertices, faces[:, ::-1].copy())
        found = sdm.signed_distance_map(mesh, GRID, orient="auto")
        assert torch.equal(found.values, _eager(_mesh(vertices, faces[:, ::-1].copy()).flipped()).values)
    assert len(launches) == 2


def test_threads():
    vertices, faces = torus(2000)
    shapes = _shapes(vertices, 10)
    grids = [GRID, sdm.Grid(GRID.origin, GRID.spacing, (31, 31, 30))]
    expected = [[_eager(_mesh(v, faces), grid).values for v in shapes] for grid in grids]
    wrong = []

    def work(number: int) -> None:
        with torch.cuda.stream(torch.cuda.Stream()):
            for v, wanted in zip(shapes, expected[number % 2], strict=True):
                found = sdm.signed_distance_map(_mesh(v, faces), grids[number % 2]).values
                torch.cuda.current_stream().synchronize()
                if not torch.equal(found, wanted):
                    wrong.append(number)

    torch.cuda.synchronize()
    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_recordings_are_evicted(launches, monkeypatch):
    graphs.clear()
    monkeypatch.setattr(replay, "_caches", {})
    monkeypatch.setattr(replay, "MOST_OF_MANY", MOST_RECORDINGS)
    vertices, faces = torus(600)
    grids = [sdm.Grid([-1.2] * 3, [0.08] * 3, [31, 31, n]) for n in range(20, 20 + MOST_RECORDINGS + 2)]
    for _ in range(2):
        for grid in grids:
            for _ in range(CALLS + 1):
                _same(sdm.signed_distance_map(_mesh(vertices, faces), grid), _eager(_mesh(vertices, faces), grid))
        (cache,) = replay._caches.values()
        assert len(cache) == MOST_RECORDINGS
        assert 0 < cache._pool.nbytes <= cache._most
    held = torch.cuda.memory_reserved()
    graphs.clear()
    torch.cuda.synchronize()
    torch.cuda.empty_cache()
    assert torch.cuda.memory_reserved() < held


def test_too_much_memory(monkeypatch, launches):
    vertices, faces = torus(600)
    sdm.signed_distance_map(_mesh(vertices, faces), GRID)
    (cache,) = replay._caches.values()
    monkeypatch.setattr(cache, "_most", 1 << 20)
    for _ in range(CALLS + 3):
        _same(sdm.signed_distance_map(_mesh(vertices, faces), GRID), _eager(_mesh(vertices, faces)))
    assert len(cache) == 0
    assert not launches


def test_gradients_still_flow(launches):
    vertices, faces = torus(600)
    for _ in range(CALLS + 1):
        sdm.signed_distance_map(_mesh(vertices, faces), GRID)
    leaf = torch.tensor(vertices).cuda().requires_grad_()
    mesh = sdm.TriangleMesh(leaf, torch.tensor(faces).cuda())
    sdm.signed_distance_map(mesh, GRID).values.sum().backward()
    assert leaf.grad is not None
    assert leaf.grad.abs().sum() > 0
    assert len(launches) == 1
    with torch.no_grad():
        assert not sdm.signed_distance_map(mesh, GRID).values.requires_grad


def test_inference_mode():
    vertices, faces = torus(600)
    expected = _eager(_mesh(vertices, faces)).values
    for step in range(8):
        with torch.inference_mode(step % 2 == 0):
            found = sdm.signed_distance_map(_mesh(vertices, faces), GRID).values
            assert torch.equal(found, expected)


def test_off(launches):
    vertices, faces = torus(600)
    graphs.enable(False)
    try:
        for _ in range(CALLS + 2):
            sdm.signed_distance_map(_mesh(vertices, faces), GRID)
    finally:
        graphs.enable(True)
    assert not launches


def test_inside_another_capture(launches):
    vertices, faces = torus(600)
    mesh = _mesh(vertices, faces)
    batch = mesh.vertices[None].clone()
    for _ in range(CALLS + 1):
        expected = sdm.signed_distance_maps(batch, mesh.faces, GRID)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        values = sdm.signed_distance_maps(batch, mesh.faces, GRID)
    graph.replay()
    torch.cuda.synchronize()
    assert torch.equal(values, expected)
    assert len(launches) == 1


def test_nothing_waits_for_a_batch(launches):
    case = load_case("torus")
    faces = torch.tensor(case.faces).cuda()
    batch = torch.tensor(np.stack(_shapes(case.vertices, 4))).cuda()
    sdm.signed_distance_maps(batch, faces, GRID)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        # Recording included.
        for _ in range(CALLS):
            sdm.signed_distance_maps(batch, faces, GRID)
        torch.cuda._sleep(400_000_000)
        sdm.signed_distance_maps(batch, faces, GRID)
        assert not torch.cuda.current_stream().query()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert len(launches) == 2


def test_a_new_mesh_waits_for_its_faces_alone(launches):
    vertices, faces = torus(600)
    # Of large maps a class is recorded a call later.
    meshes = [_mesh(vertices, faces) for _ in range(CALLS + 6)]
    large = sdm.Grid([-1.2] * 3, [0.005] * 3, [480] * 3)
    for mesh in meshes[:-4]:
        sdm.signed_distance_map(mesh, large)
    # A host with much else to do may once take as long as the GPU.
    returned_before = []
    for mesh in meshes[-4:]:
        torch.cuda.synchronize()
        sdm.signed_distance_map(mesh, large)
        returned_before.append(not torch.cuda.current_stream().query())
    assert any(returned_before)
    assert len(launches) == 1 + len(returned_before)


@pytest.mark.usefixtures("whole_gpu")
def test_memory_stays_flat():
    vertices, faces = torus(600)

    def calls(many: int) -> int:
        for step in range(many):
            grid = sdm.Grid([-1.2] * 3, [0.08] * 3, [31, 31, 20 + step % 7])
            for _ in range(CALLS + 1):
                sdm.signed_distance_map(_mesh(vertices, faces), grid)
        torch.cuda.synchronize()
        return torch.cuda.mem_get_info()[0]

    before = calls(14)
    assert calls(28) >= before - (64 << 20)
