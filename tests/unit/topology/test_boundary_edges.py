"""Boundary edges: what is left of every face's directed edges."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings

import sdm.topology.boundary_edges
import sdm.topology.face_pairing
from sdm.bench.common.meshes import cube, load_case, sphere
from sdm.errors import MeshError
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.cap_triangles import cap_triangles
from tests.helpers import strategies


def _edges(vertices, faces) -> list[tuple[int, int]]:
    found = boundary_edges(
        torch.as_tensor(np.asarray(vertices, np.float32)), torch.as_tensor(np.array(faces, np.int32))
    )
    assert found.dtype == torch.int32
    return sorted(map(tuple, found.tolist()))


CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]]


def test_a_triangle_has_its_three_edges_with_the_surface_on_the_left():
    assert _edges(CORNERS, [[0, 1, 2]]) == [(0, 1), (1, 2), (2, 0)]
    assert _edges(CORNERS, [[0, 2, 1]]) == [(0, 2), (1, 0), (2, 1)]


def test_two_triangles_share_an_edge():
    assert _edges(CORNERS, [[0, 1, 2], [1, 3, 2]]) == [(0, 1), (1, 3), (2, 0), (3, 2)]


def test_two_triangles_that_disagree_have_it_twice():
    assert _edges(CORNERS, [[0, 1, 2], [1, 2, 3]]).count((1, 2)) == 2


def test_three_wings():
    assert _edges(CORNERS, [[0, 1, 2], [0, 1, 3], [0, 1, 4]]).count((0, 1)) == 3
    # One of them the other way round takes one away.
    assert _edges(CORNERS, [[0, 1, 2], [1, 0, 3], [0, 1, 4]]).count((0, 1)) == 1


@pytest.mark.parametrize(
    "name", ["cube", "torus", "needle fan", "unmerged sphere", "zero-area faces", "inverted sphere"]
)
def test_closed_meshes_have_none(name):
    case = load_case(name)
    assert _edges(case.vertices, case.faces) == []


@pytest.mark.parametrize("face", [[0, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0]])
def test_faces_without_area_that_repeat_a_corner_have_none(face):
    assert _edges(CORNERS, [face]) == []


def test_collinear_faces_have_theirs():
    """They have no area, but a neighbour that shares one of their edges needs it back."""
    line = [[0, 0, 0], [2, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert len(_edges(line, [[0, 1, 2]])) == 3
    assert _edges(line, [[0, 2, 3], [2, 1, 3], [0, 1, 2]]) == [(0, 1), (1, 3), (3, 0)]


def test_equal_positions_count_as_one():
    vertices, faces = cube()
    loose = vertices[faces].reshape(-1, 3)
    index = np.arange(36).reshape(-1, 3)
    assert _edges(loose, index) == []
    loose[0] += 1e-6
    assert len(_edges(loose, index)) == 4


def test_minus_zero_is_zero():
    vertices, faces = cube()
    loose = (vertices[faces] + 1).reshape(-1, 3)
    loose[::2] = np.where(loose[::2] == 0, -0.0, loose[::2])
    assert np.signbit(loose).any()
    assert _edges(loose, np.arange(36).reshape(-1, 3)) == []


def test_nearly_equal_positions_do_not():
    """Neighbouring float32 numbers, tiny and huge ones are told apart."""
    for number in (0.0, 1.0, -1.0, 1e-30, -1e30):
        next_one = np.nextafter(np.float32(number), np.float32(np.inf))
        vertices = np.array([[number, 0, 0], [0, 1, 0], [0, 0, 1], [next_one, 0, 0]], np.float32)
        assert len(_edges(vertices, [[0, 1, 2], [3, 2, 1]])) == 4


def test_batches_merge_only_what_is_equal_in_all():
    vertices, faces = cube()
    loose = np.stack([vertices[faces].reshape(-1, 3)] * 3)
    index = torch.arange(36, dtype=torch.int32).reshape(-1, 3)
    assert boundary_edges(torch.tensor(loose), index).shape == (0, 2)
    loose[1, 5, 2] += 0.5
    edges = boundary_edges(torch.tensor(loose), index)
    assert edges.shape[0] > 0
    assert (edges == 5).any()


@pytest.mark.parametrize("bad", [8, -1, 2**31 - 1, -(2**31)])
def test_indices_out_of_range(bad):
    vertices, faces = cube()
    faces[3, 1] = bad
    with pytest.raises(MeshError, match=f"vertex {bad}, but the 8 vertices are numbered 0 to 7"):
        boundary_edges(torch.tensor(vertices), torch.tensor(faces))


@settings(max_examples=50)
@given(strategies.soups())
def test_every_boundary_closes(mesh):
    """As many edges leave a place as come to it, and adding the boundary's other side closes the mesh."""
    edges = boundary_edges(torch.tensor(mesh.vertices), torch.tensor(mesh.faces))
    places = [tuple(row) for row in (mesh.vertices + 0).tolist()]
    balance: dict[tuple, int] = {}
    for start, end in edges.tolist():
        assert places[start] != places[end]
        balance[places[start]] = balance.get(places[start], 0) + 1
        balance[places[end]] = balance.get(places[end], 0) - 1
    assert not any(balance.values())
    if len(edges):
        # A fan over the boundary.
        tip = len(mesh.vertices)
        vertices = np.concatenate([mesh.vertices, [[9, 9, 9]]]).astype(np.float32)
        fan = np.array([[end, start, tip] for start, end in edges.tolist()], np.int32)
        assert _edges(vertices, np.concatenate([mesh.faces, fan])) == []


@settings(max_examples=30)
@given(strategies.closed())
def test_boundaries_of_solids_are_closed(mesh):
    assert _edges(mesh.vertices, mesh.faces) == []


def test_the_same_faces_are_sorted_once(monkeypatch):
    calls = []
    plain = sdm.topology.face_pairing.PairingUnderWay
    monkeypatch.setattr(sdm.topology.face_pairing, "PairingUnderWay", lambda *args: calls.append(1) or plain(*args))
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    for _ in range(5):
        assert boundary_edges(vertices, faces).shape == (0, 2)
    assert len(calls) == 1
    faces[0] = faces[1]
    boundary_edges(vertices, faces)
    assert len(calls) > 1


def test_faces_are_not_kept_alive():
    import gc
    import weakref

    vertices, faces = (torch.tensor(array) for array in sphere(6))
    boundary_edges(vertices, faces)
    gone = weakref.ref(faces)
    del faces
    gc.collect()
    assert gone() is None


def _counted(monkeypatch, module, name: str) -> list:
    calls = []
    plain = getattr(module, name)
    monkeypatch.setattr(module, name, lambda *args: calls.append(name) or plain(*args))
    return calls


def test_a_mesh_that_moves_keeps_what_its_faces_say(monkeypatch):
    case = load_case("open hemisphere")
    paired = _counted(monkeypatch, sdm.topology.face_pairing, "PairingUnderWay")
    looped = _counted(monkeypatch, sdm.topology.cap_triangles, "caps_on_host")
    mesh = sdm.TriangleMesh(torch.tensor(case.vertices), torch.tensor(case.faces))
    index = sdm.MeshIndex(mesh, "cpu")
    index.update(mesh.vertices * 2)
    sdm.MeshIndex(mesh, "cpu")
    sdm.MeshIndex(sdm.TriangleMesh(mesh.vertices + 1, mesh.faces), "cpu")
    assert (len(paired), len(looped)) == (1, 1)


def test_a_boundary_that_opens_is_found_anew():
    vertices, faces = cube()
    loose, index = torch.tensor(vertices[faces].reshape(-1, 3)), torch.arange(36, dtype=torch.int32).reshape(-1, 3)
    assert boundary_edges(loose, index).shape == (0, 2)
    torn = loose.clone()
    torn[0] += 1
    found = boundary_edges(torn, index)
    assert found.shape == (4, 2)
    assert boundary_edges(torn * 2, index) is found
    assert boundary_edges(loose, index).shape == (0, 2)
    assert torch.equal(boundary_edges(torn, index), found)


def test_an_edge_written_into_is_not_given_again():
    vertices, faces = (torch.tensor(array) for array in cube())
    faces = faces[:-1].contiguous()
    found = boundary_edges(vertices, faces)
    kept = found.clone()
    found += 1
    assert torch.equal(boundary_edges(vertices, faces), kept)


def test_remembered_faces_are_checked_for_fewer_vertices_too():
    vertices, faces = (torch.tensor(array) for array in cube())
    assert boundary_edges(vertices, faces).shape == (0, 2)
    with pytest.raises(MeshError, match="vertex 7, but the 7 vertices"):
        boundary_edges(vertices[:7], faces)


def test_nothing_large_is_kept_of_a_mesh_with_a_small_hole():
    vertices, faces = (torch.tensor(array) for array in sphere(40))
    faces = faces[1:].contiguous()
    for limit in (1 << 12, 1):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sdm.topology.boundary_edges, "MOST_ON_HOST", limit)
            fresh = faces.clone()
            assert boundary_edges(vertices, fresh).shape == (3, 2)
            kept = sdm.topology.face_pairing.pairing_of(fresh, len(vertices)).unmatched
            assert kept.shape == (3, 3)
            assert kept.untyped_storage().nbytes() < 1000


def test_in_inference_mode_nothing_is_remembered_wrongly():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    with torch.inference_mode():
        index = faces[1:].clone()
        assert boundary_edges(vertices, index).shape == (3, 2)
        index[:] = faces[0]
        assert boundary_edges(vertices, index).shape == (3 * len(index), 2)
        once = faces[1:].clone()
        assert cap_triangles(boundary_edges(vertices, once)).shape == (3, 3)


def test_what_inference_mode_found_serves_outside():
    vertices, faces = (torch.tensor(array) for array in sphere(6))
    faces = faces[1:].contiguous()
    with torch.inference_mode():
        inside = boundary_edges(vertices, faces)
        caps = cap_triangles(inside)
    outside = boundary_edges(vertices, faces)
    assert torch.equal(inside, outside)
    assert torch.equal(caps, cap_triangles(outside))
    assert sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu").closed is False
