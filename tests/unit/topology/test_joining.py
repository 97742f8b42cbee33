"""Joining boundary edges at equal positions: host, torch and plain loops over all faces agree."""

from __future__ import annotations

from collections import Counter
from unittest import mock

import numpy as np
import pytest
import torch
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm.topology.boundary_edges
from sdm.bench.common.meshes import cube, sphere, torus
from sdm.kernels.topology import boundary_flags, boundary_loops
from sdm.runtime.torch_warp import as_warp, workspace
from sdm.topology import face_pairing
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.cap_triangles import cap_triangles
from sdm.topology.device_joining import queue_joining
from sdm.topology.joining import join_on_device, join_on_host
from tests.helpers import strategies


def _plain(vertices: np.ndarray, faces: np.ndarray) -> list[tuple[int, int]]:
    """The definition: all vertices of (B,V,3) are joined, all edges of all faces are added up."""
    loose = _balance(faces, {vertex: vertex for vertex in range(vertices.shape[1])})
    first: dict[tuple, int] = {}
    for vertex in sorted({vertex for edge in loose for vertex in edge}):
        first.setdefault(_place(vertices, vertex), vertex)
    # A vertex that no edge is left over at may have any number, so long as its place has one.
    same = {v: first.setdefault(_place(vertices, v), v) for v in range(vertices.shape[1])}
    joined = _balance(faces, same)
    found = []
    for low, high in sorted(joined):
        times = joined[low, high]
        found += [(low, high) if times > 0 else (high, low)] * abs(times)
    return found


def _place(vertices: np.ndarray, vertex: int) -> tuple:
    return tuple((vertices[:, vertex] + 0.0).ravel().tolist())


def _balance(faces: np.ndarray, same: dict[int, int]) -> dict[tuple[int, int], int]:
    balance: Counter = Counter()
    for face in faces.tolist():
        for k in range(3):
            start, end = same[face[k]], same[face[(k + 1) % 3]]
            if start != end:
                balance[min(start, end), max(start, end)] += 1 if start < end else -1
    return {edge: times for edge, times in balance.items() if times}


def _edges_balance(edges: torch.Tensor) -> dict[tuple[int, int], int]:
    balance: Counter = Counter()
    for start, end in edges.tolist():
        balance[min(start, end), max(start, end)] += 1 if start < end else -1
    return {edge: times for edge, times in balance.items() if times}


def _both(vertices: np.ndarray, faces: np.ndarray) -> torch.Tensor:
    """Boundary edges by both ways, which must be one."""
    batch, index = torch.tensor(vertices), torch.tensor(faces)
    found = boundary_edges(batch, index)
    unmatched = face_pairing.PairingUnderWay(index, batch.shape[-2]).finish().unmatched
    if unmatched.shape[0]:
        # In any order.
        unmatched = unmatched[torch.randperm(len(unmatched), generator=torch.Generator().manual_seed(3))]
        batch = batch.reshape(-1, *batch.shape[-2:])
        by_torch = join_on_device(unmatched, batch)
        places = batch.numpy()[:, unmatched[:, :2].reshape(-1).numpy()].transpose(1, 0, 2)
        by_numpy = join_on_host(unmatched.numpy(), np.ascontiguousarray(places).reshape(len(places), -1))
        for other in (by_torch, torch.from_numpy(by_numpy)):
            assert other.dtype == torch.int32
            assert torch.equal(other, found)
        _by_kernels(batch, index, len(unmatched), found)
    else:
        assert len(found) == 0
    return found


def _by_kernels(batch: torch.Tensor, index: torch.Tensor, rows: int, expected: torch.Tensor) -> None:
    """The same by kernels that are told how many there are, and their flags if that is wrong."""
    flags, unmatched, _ = face_pairing.queue_pairing(index, batch.shape[1])

    def joined(rows: int, edges: int) -> tuple[list[int], torch.Tensor, torch.Tensor]:
        said, bounds, caps = queue_joining(unmatched, flags, batch, rows, edges)
        return said.tolist(), bounds, caps

    count = len(expected)
    said, bounds, caps = joined(rows, count)
    assert torch.equal(bounds, expected)
    for room in (False, True):
        for found, other in zip(
            *(_queued(batch, unmatched, flags, rows, count, room, most) for most in (rows, 0)), strict=True
        ):
            assert torch.equal(found, other)
    starts = Counter(expected[:, 0].tolist())
    assert said == [0, 0, 0, 0]
    if len(starts) == count > 0:
        assert torch.equal(caps, cap_triangles(expected))
    else:
        # Loops that meet may be cut otherwise, but are closed.
        opposite = {edge: -times for edge, times in _edges_balance(expected).items()}
        assert _balance(caps.numpy(), {vertex: vertex for vertex in range(batch.shape[1])}) == opposite
    # Rows that are not there hold whatever was in memory before, such as so many edges that a sum of them overflows.
    limits = torch.iinfo(torch.int32)
    unmatched[rows:] = torch.tensor([0, limits.max, limits.min], dtype=torch.int32)
    for other in ((rows + 1, count), (rows - 1, count), (rows, count + 1), (rows, max(count - 1, 0))):
        if other != (rows, count) and 0 < other[0] <= len(unmatched):
            assert any(joined(*other)[0])
            # Those that sort say the same where they are wrong.
            for room in (False, True):
                compared, by_sorts = (
                    _queued(batch, unmatched, flags, *other, room, most)[0] for most in (max(other), 0)
                )
                assert torch.equal(compared, by_sorts)


def _queued(batch, unmatched, flags, rows, count, in_room, most) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Flags and numbers, edges and caps, by kernels that compare all with all up to so many edges, and sort more."""
    spare = 5 if in_room else 0
    said = torch.zeros(boundary_flags.NUMBERS, dtype=torch.int32)
    edges = torch.zeros(count + spare, 2, dtype=torch.int32)
    caps = torch.full((count + spare, 3), -1, dtype=torch.int32)
    with mock.patch.object(boundary_loops, "MOST_COMPARED", most + 2 * spare if most else 0):
        boundary_loops.join_edges(
            as_warp(unmatched[: rows + spare], wp.int32),
            as_warp(flags, wp.int32),
            as_warp(batch, wp.vec3),
            as_warp(edges, wp.int32),
            as_warp(caps, wp.int32),
            as_warp(said, wp.int32),
            workspace(batch.device),
            in_room=in_room,
        )
    return said, edges, caps


def _loose(mesh: strategies.Arrays, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A part of the faces with corners of their own, and half of the zeros negative."""
    rng = np.random.default_rng(seed)
    own = rng.random(len(mesh.faces)) < share
    faces = mesh.faces.copy()
    faces[own] = len(mesh.vertices) + np.arange(3 * own.sum()).reshape(-1, 3)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[mesh.faces[own]].reshape(-1, 3)])
    vertices = np.where((vertices == 0) & (rng.random(vertices.shape) < 0.5), np.float32(-0.0), vertices)
    number = rng.permutation(len(vertices))
    moved = np.empty_like(vertices)
    moved[number] = vertices
    return moved.astype(np.float32), number[faces].astype(np.int32)


@settings(max_examples=80)
@given(
    st.one_of(strategies.soups(), strategies.closed()),
    st.sampled_from([0.0, 0.3, 1.0]),
    st.integers(1, 3),
    strategies.seeds,
)
def test_all_ways_agree(mesh, share, meshes, seed):
    vertices, faces = _loose(mesh, share, seed)
    rng = np.random.default_rng(seed)
    batch = np.stack([vertices] * meshes)
    # The other meshes are torn at a few vertices, or have others that coincide.
    for other in batch[1:]:
        where = rng.integers(0, len(vertices), 2)
        other[where[0]] = other[where[1]] if rng.random() < 0.5 else other[where[0]] + 1
    assert _both(batch, faces).tolist() == [list(edge) for edge in _plain(batch, faces)]


def _half_a_sphere() -> strategies.Arrays:
    vertices, faces = sphere(14)
    return strategies.Arrays(vertices, faces[vertices[faces, 2].min(1) > -1e-6])


@pytest.mark.parametrize("mesh", [_half_a_sphere(), strategies.Arrays(*torus(500))], ids=["half a sphere", "torus"])
@pytest.mark.parametrize("meshes", [1, 12])
def test_torn_meshes(mesh, meshes):
    faces = mesh.faces[np.arange(len(mesh.faces)) % 97 != 0]
    vertices, faces = _loose(strategies.Arrays(mesh.vertices, faces), 0.3, 5)
    batch = np.stack([vertices * np.float32(1 + m) for m in range(meshes)])
    found = _both(batch, faces)
    assert found.tolist() == [list(edge) for edge in _plain(batch[:1], faces)]


def test_a_closed_soup_of_triangles_is_closed():
    vertices, faces = sphere(12)
    loose, index = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    assert _both(loose, index).shape == (0, 2)
    assert _both(np.stack([loose] * 3), index).shape == (0, 2)


def test_a_vertex_within_the_surface_at_the_same_place_changes_nothing():
    """The flap's corner touches a cube's: the cube has no edge left over, so the flap keeps its own vertices."""
    vertices, faces = cube()
    flap = np.array([vertices[0], [5, 5, 5], [6, 5, 5]], np.float32)
    found = _both(np.concatenate([vertices, flap]), np.concatenate([faces, [[8, 9, 10]]]).astype(np.int32))
    assert found.tolist() == [[8, 9], [10, 8], [9, 10]]


@pytest.mark.parametrize("limit", ["MOST_ON_HOST", "MOST_ON_HOST_IN_ALL"])
def test_beyond_the_limit_the_result_is_the_same(monkeypatch, limit):
    vertices, faces = _loose(_half_a_sphere(), 0.5, 7)
    batch = torch.tensor(np.stack([vertices] * 2))
    few = boundary_edges(batch, torch.tensor(faces))
    monkeypatch.setattr(sdm.topology.boundary_edges, limit, 1)
    monkeypatch.setattr(sdm.topology.boundary_edges, "join_on_host", None)
    index = torch.tensor(faces)
    many = boundary_edges(batch, index)
    assert torch.equal(few, many)
    assert torch.equal(cap_triangles(few), cap_triangles(many))
    # And once more, from what was remembered.
    assert torch.equal(boundary_edges(batch, index), many)


def test_the_order_of_faces_changes_neither_edges_nor_caps():
    mesh = _half_a_sphere()
    vertices, faces = _loose(strategies.Arrays(mesh.vertices, mesh.faces[5:]), 0.3, 9)
    found = _both(vertices, faces)
    turned = _both(vertices, np.roll(faces[::-1], 1, 1).copy())
    assert torch.equal(found, turned)
    assert torch.equal(cap_triangles(found), cap_triangles(turned))


@pytest.mark.parametrize("fans", [2, 7, 40])
def test_rims_that_meet_at_a_vertex(fans):
    """Triangles with one corner in common: as many loops through it."""
    vertices = np.random.default_rng(fans).normal(size=(2 * fans + 1, 3)).astype(np.float32)
    faces = np.array([[0, 2 * i + 1, 2 * i + 2] for i in range(fans)], np.int32)
    assert len(_both(vertices, faces)) == 3 * fans
