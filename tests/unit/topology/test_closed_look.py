"""One look at meshes on the host: what it calls plain, the pairing of faces and the volumes of components call so."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.bench.common.mesh_formulas import cube, joined, moved, torus
from sdm.core.mesh import TriangleMesh
from sdm.inspect.quick_look import LEAST_VOLUME, PLAIN_VOLUME, look_at
from sdm.kernels.topology.closed_look import slots_for
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.closed_look import is_plainly_closed
from sdm.topology.component_volumes import every_component_encloses
from sdm.topology.face_pairing import neighbours


def look(vertices: np.ndarray, faces: np.ndarray) -> bool:
    mesh = TriangleMesh(vertices, faces)
    found = is_plainly_closed(mesh.vertices, mesh.faces, PLAIN_VOLUME)
    if found:
        assert boundary_edges(mesh.vertices, mesh.faces).shape[0] == 0
        around = neighbours(mesh.faces, len(mesh.vertices))
        assert every_component_encloses(LEAST_VOLUME, mesh.vertices, mesh.faces, around)
    return found


@pytest.mark.parametrize("far", [0.0, 1e4])
def test_closed_ones(far):
    vertices, faces = torus(2000)
    assert look(vertices + np.float32(far), faces)
    assert look(*joined((vertices, faces), moved((vertices, faces), 1.0, (5.0, 0, 0)), cube()))
    shuffled = np.random.default_rng(0).permutation(len(faces))
    assert look(vertices, faces[shuffled])


def test_others():
    vertices, faces = torus(2000)
    assert not look(vertices, faces[1:]), "a face is gone"
    assert not look(vertices, faces[:, ::-1]), "inside out"
    assert not look(vertices, np.concatenate([faces[:1, ::-1], faces[1:]])), "a face looks inward"
    assert not look(*joined((vertices, faces), moved((vertices, faces[:, ::-1]), 1.0, (5.0, 0, 0)))), (
        "a part is inside out"
    )
    assert not look(vertices, np.concatenate([faces, faces[:2]])), "repeated faces"
    assert not look(vertices, np.concatenate([faces, faces[:1], faces[:1, ::-1]])), "an edge of four faces"
    assert not look(vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)), "vertices of their own"
    assert not look(vertices * [1, 1, 0], faces), "flat"
    degenerate = np.concatenate([faces, [[0, 0, 1], [1, 0, 0]]])
    assert not look(vertices, degenerate)
    assert not is_plainly_closed(torch.zeros(3, 3), torch.tensor([[0, 1, 2]] * 2 + [[0, 2, 9]] * 2).int(), 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_soup(seed):
    """Random faces of few vertices: nothing hangs, and what is called plain is."""
    random = np.random.default_rng(seed)
    faces = random.integers(0, 5, (2 * random.integers(2, 40), 3))
    look(random.random((5, 3)), faces)


def test_memory_of_the_table():
    for faces in (4, 20, 1000, 20_000, 99_999):
        assert slots_for(faces) > 3 * faces // 2
        assert slots_for(faces).bit_count() == 1


def test_looks_are_remembered():
    vertices, faces = cube()
    mesh = TriangleMesh(vertices, faces)
    assert look_at(mesh).is_closed(mesh)
    assert look_at(mesh).problems(mesh) == []
    open_mesh = TriangleMesh(vertices, faces[1:])
    assert not look_at(open_mesh).is_closed(open_mesh)
    inward = TriangleMesh(vertices, np.ascontiguousarray(faces[:, ::-1]))
    assert look_at(inward).is_closed(inward)
    assert look_at(inward).problems(inward)
