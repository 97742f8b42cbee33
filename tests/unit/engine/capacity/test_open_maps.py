"""Maps of open meshes by capacity class: the bits of calls for a mesh's own counts, whatever its boundary."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import half_spheres, sheets, torn
from sdm.bench.common.mesh_formulas import torus
from sdm.bench.dense.launch_counts import as_on_a_gpu
from sdm.engine.capacity import open_boundary
from sdm.engine.capacity.class_calls import class_call
from sdm.engine.capacity.classes import BY_FACES, LARGEST_ROOM, LEAST_FEW, MANY_EDGES, MOST_EDGES, class_of
from sdm.engine.capacity.open_boundary import OpenBoundary
from sdm.engine.plan_override import plan_override
from sdm.kernels.topology.boundary_flags import FLAGS, WRONG_EDGES, WRONG_UNMATCHED, WRONG_VERTEX
from sdm.kernels.topology.edge_table import MOST_ALIKE
from sdm.kernels.winding.rims import every_voxel
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.face_pairing import neighbours, pairing_of
from tests.helpers.by_table import by_table


def _flipped(seed):
    vertices, faces = torus(840)
    some = np.random.default_rng(seed).random(len(faces)) < 0.5
    return vertices, np.where(some[:, None], faces[:, [0, 2, 1]], faces)


def _loose():
    """Each triangle with vertices of its own, a tenth of them elsewhere."""
    vertices, faces = torus(200)
    apart = vertices[faces].reshape(-1, 3)
    apart[:60] += np.float32(0.01)
    return apart, np.arange(len(apart), dtype=np.int32).reshape(-1, 3)


def _flat():
    """Faces of one vertex, of two, and of three on a line, at a hole and elsewhere."""
    vertices, faces = torus(400)
    middle = 0.5 * (vertices[faces[0, 0]] + vertices[faces[0, 1]])
    some = [[len(vertices), faces[0, 0], faces[0, 1]], [5, 5, 5], [7, 7, 9], [faces[0, 1], faces[0, 2], faces[0, 2]]]
    return np.concatenate([vertices, middle[None]]), np.concatenate([faces[1:], np.int32(some)])


def _meeting():
    """Two holes that meet at a vertex, and a face that is there twice."""
    vertices, faces = torus(400)
    around = np.flatnonzero((faces == faces[0, 0]).any(1))
    faces = np.delete(faces, around[[0, 3]], 0)
    return vertices, np.concatenate([faces, faces[50:51]])


MESHES = {
    "torn": lambda: torn(torus(400), 0.1),
    "torn to pieces": lambda: torn(torus(1000), 0.4),
    "half spheres": lambda: half_spheres(3),
    "sheets": lambda: sheets(20),
    "closed": lambda: torus(400),
    "loose triangles": _loose,
    "loops that meet": _meeting,
    "more boundary edges than faces": lambda: _flipped(1),
    "one triangle": lambda: (torus(200)[0], torus(200)[1][:1]),
    "zero-area faces": _flat,
}


def _grid(vertices, turned=False):
    low, high = vertices.min(0), vertices.max(0)
    direction = [[0, 1, 0], [1, 0, 0], [0, 0, 1]] if turned else np.eye(3)
    return sdm.Grid(low - 0.07 * (high - low).max(), (high - low).max() / 20 * np.ones(3), (24, 20, 27), direction)


def _class_map(vertices, faces, grid, room=MOST_EDGES):
    kind, decisions = class_of(faces.shape[0], vertices.shape[0], grid, None)
    given = vertices, faces, grid, len(vertices), len(faces), faces.device
    found, numbers, told = by_table(class_call(kind, decisions, given, room))
    assert told == len(numbers) - FLAGS
    return found, OpenBoundary.of_memory(found.told.boundary, room), numbers


def _same(mesh, grid, room=MOST_EDGES):
    vertices, faces = (torch.from_numpy(np.ascontiguousarray(array)) for array in mesh)
    found, boundary, numbers = _class_map(vertices, faces, grid, room)
    expected = sdm.MeshIndex((vertices, faces), "cpu", warn=False).signed_distance_map(grid)
    edges = boundary_edges(vertices, faces)
    assert numbers[:FLAGS] == [0] * FLAGS
    assert numbers[-1] == len(edges)
    assert torch.equal(boundary.edges[: len(edges)], edges)
    assert torch.equal(found.told.neighbours, neighbours(faces, len(vertices)))
    assert torch.equal(found.values, expected.values)
    assert found.told.ambiguous.tolist() == [expected.ambiguous_voxels]
    rows = numbers[FLAGS]
    assert sorted(found.told.unmatched[:rows].tolist()) == sorted(pairing_of(faces, len(vertices)).unmatched.tolist())
    return numbers


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("turned", [False, True])
def test_the_same_bits(name, turned):
    mesh = MESHES[name]()
    numbers = _same(mesh, _grid(mesh[0], turned))
    assert (numbers[-1] == 0) == (name == "closed")


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("turned", [False, True])
def test_few_edges_are_added_up_at_every_voxel(monkeypatch, name, turned):
    """As on a GPU, where a small map of a mesh with few boundary edges has neither caps nor boxes."""
    mesh = MESHES[name]()
    grid = _grid(mesh[0], turned)
    edges = len(boundary_edges(*(torch.from_numpy(np.ascontiguousarray(array)) for array in mesh)))
    room = max(LEAST_FEW, edges, len(pairing_of(torch.from_numpy(mesh[1].copy()), len(mesh[0])).unmatched)) + 3
    monkeypatch.setitem(every_voxel.MOST_SUMS, "cpu", room * grid.size)
    kind, _ = class_of(len(mesh[1]), len(mesh[0]), grid, None)
    assert kind.few_edges("cpu") == min(room, MOST_EDGES)
    monkeypatch.setattr(open_boundary, "build_caps", None)
    _same(mesh, grid, min(room, MOST_EDGES))


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("turned", [False, True])
def test_faces_turned_inside_out_are_caps_too(name, turned):
    mesh = MESHES[name]()
    _same(mesh, _grid(mesh[0], turned), BY_FACES[int(turned)])


@pytest.mark.parametrize("room", [MANY_EDGES, LARGEST_ROOM])
def test_room_for_more_edges_than_faces_have(room):
    mesh = MESHES["torn"]()
    assert 3 * class_of(len(mesh[1]), len(mesh[0]), _grid(mesh[0]), None)[0].faces < room
    _same(mesh, _grid(mesh[0]), room)


def test_more_edges_than_are_compared_with_each_other():
    mesh = torn(torus(14_000), 0.5)
    assert _same(mesh, _grid(mesh[0]), LARGEST_ROOM)[-1] > MANY_EDGES


@pytest.mark.parametrize("kind", ["all apart", "one is missing"])
def test_triangles_that_share_no_vertices(kind):
    """As in an STL file: many edges are left unmatched, few or none once vertices at one place are one."""
    vertices, faces = torus(3000)
    corners = vertices[faces[kind == "one is missing" :]].reshape(-1, 3)
    mesh = corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    assert _same(mesh, _grid(mesh[0]), LARGEST_ROOM)[-1] == 3 * (kind == "one is missing")


@pytest.mark.parametrize("seed", range(6))
def test_random_dirt(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = torn(torus(int(rng.integers(50, 900))), rng.uniform(0.01, 0.5))
    vertices = vertices + rng.normal(0, 0.02, vertices.shape).astype(np.float32)
    # Some vertices twice, some faces turned or twice.
    own, faces = rng.random(len(faces)) < 0.1, faces.copy()
    twice = vertices[faces[own, 0]]
    faces[own, 0] = len(vertices) + np.arange(own.sum())
    vertices = np.concatenate([vertices, twice])
    some = rng.random(len(faces)) < 0.1
    faces[some] = faces[some][:, [1, 0, 2]]
    mesh = vertices.astype(np.float32), np.concatenate([faces, faces[:5]]).astype(np.int32)
    _same(mesh, _grid(mesh[0], bool(seed % 2)))


def test_with_choices_of_a_gpu():
    mesh = MESHES["torn to pieces"]()
    with as_on_a_gpu(1 << 30):
        _same(mesh, _grid(mesh[0]))
    with plan_override(shares=(8, 2), split_length=32, slice_factors=(1,)):
        _same(mesh, _grid(mesh[0]))


def test_what_does_not_fit_is_told():
    vertices, faces = (torch.from_numpy(array) for array in torus(3000))
    grid = _grid(vertices.numpy())
    torn_up = faces[::2].contiguous()
    many = _class_map(vertices, torn_up, grid)[2]
    assert many[WRONG_UNMATCHED] == len(pairing_of(torn_up, len(vertices)).unmatched) - MOST_EDGES > 0
    outside = _class_map(vertices, faces.where(faces != 7, len(vertices)), grid)[2]
    assert outside[WRONG_VERTEX] != 0
    # Three of each triangle of a few, so that edges count three times.
    some = torch.cat(3 * [faces[::8]]).contiguous()
    rows = len(pairing_of(some, len(vertices)).unmatched)
    more = _class_map(vertices, some, grid)[2]
    assert rows <= MOST_EDGES
    assert more[WRONG_UNMATCHED] == 0
    assert more[WRONG_EDGES] == len(boundary_edges(vertices, some)) - MOST_EDGES > 0
    # With more of one edge than its list is looked through for, whoever asks has to sort.
    times = torch.cat([faces[:-1], faces[:1].expand(MOST_ALIKE + 1, 3)]).contiguous()
    assert _class_map(vertices, times, grid)[2][WRONG_VERTEX] != 0


@pytest.mark.parametrize("faces_at_an_edge", [40, 300])
def test_many_loops_meet(faces_at_an_edge):
    """Triangles about one edge: each of them is a loop through the same two vertices."""
    vertices, faces = torus(900)
    about = faces[:1].repeat(faces_at_an_edge, 0)
    about[:, 2] = np.setdiff1d(np.arange(len(vertices)), faces[0, :2])[:faces_at_an_edge]
    fan = np.concatenate([faces[:-1], about])
    _same((vertices, fan), _grid(vertices))


def test_what_has_no_room_leaves_no_index_out_of_range():
    """The map has no meaning then, but it ends."""
    vertices, faces = (torch.from_numpy(array) for array in torus(3000))
    torn_up = faces[::2].contiguous()
    _, boundary, _ = _class_map(vertices, torn_up, _grid(vertices.numpy()))
    for index in (boundary.edges, boundary.caps):
        assert 0 <= int(index.min()) <= int(index.max()) < len(vertices)
