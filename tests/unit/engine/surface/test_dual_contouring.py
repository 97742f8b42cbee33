"""Dual contouring: manifolds of any field, and edges and corners that stay sharp."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import torch

import sdm
from sdm.core.mesh import TriangleMesh
from sdm.errors import SDMError
from sdm.remeshing.deviation import deviation
from tests.helpers.closed_surface import areas_and_volume, assert_closed_manifold, assert_edges_cancel

TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]


def box() -> TriangleMesh:
    """A turned cube of edge 1, whose corners are multiples of a half."""
    vertices = np.array(list(product((-0.5, 0.5), repeat=3))) @ TURN.T
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])
    mesh = TriangleMesh(vertices, faces, "box")
    return mesh if areas_and_volume(mesh)[1] > 0 else mesh.flipped()


@pytest.mark.parametrize("seed", range(30))
def test_noise_has_a_closed_manifold(seed):
    """Ambiguous faces whose pieces would be joined twice are decided the other way."""
    random = np.random.default_rng(seed)
    shape = (6, 6, 6) if seed % 3 else random.integers(1, 20, 3)
    values = random.normal(size=shape) if seed % 2 else random.integers(-1, 2, shape) / 2
    values = np.pad(values, 1, constant_values=1)
    if values.min() >= 0:
        return
    field = sdm.SDM(values, sdm.Grid((0, 0, 0), (1, 1.5, 2), values.shape))
    mesh = field.to_mesh(method="dual")
    assert_edges_cancel(mesh.numpy()[1], len(mesh.vertices))
    assert areas_and_volume(mesh)[1] > 0


@pytest.mark.parametrize("direction", [np.eye(3), np.diag([1.0, -1.0, 1.0]), TURN])
def test_a_sphere_faces_outward(direction):
    grid = sdm.Grid(direction @ (-1.3, -1.3, -1.3), (0.1, 0.1, 0.1), (27, 27, 27), direction)
    mesh = sdm.SDM(grid.points().norm(dim=-1) - 1, grid).to_mesh(method="dual")
    assert_closed_manifold(mesh)
    radius = mesh.vertices.norm(dim=1)
    assert 0.99 < float(radius.min()) <= float(radius.max()) < 1.01


def test_a_turned_box_keeps_its_edges_and_corners():
    mesh = box()
    grid = sdm.Grid.around(mesh, 20, margin=0.2)
    field, step = sdm.signed_distance_map(mesh, grid), grid.spacing[0]
    sharp, cubes = field.to_mesh(method="dual", mesh=mesh), field.to_mesh()
    assert_closed_manifold(sharp)
    # The corners, and points of the twelve edges.
    corners = mesh.vertices.double()
    near = [(i, j) for i in range(8) for j in range(i) if float((corners[i] - corners[j]).norm()) < 1.1]
    share = torch.linspace(0, 1, 30, dtype=torch.float64)[:, None]
    edges = torch.cat([corners[i] + share * (corners[j] - corners[i]) for i, j in near])
    assert float(sdm.signed_distance(sharp, edges, sign="none").max()) < 0.01 * step
    assert float(sdm.signed_distance(cubes, edges, sign="none").max()) > 0.3 * step
    assert areas_and_volume(sharp)[1] == pytest.approx(1, rel=1e-4)


def test_a_level_outside_is_the_offset_itself():
    """Faces 0.2 further out, and cylinders of that radius around edges, to within a quarter voxel."""
    mesh, index = box(), sdm.MeshIndex(box())
    field = index.signed_distance_map(sdm.Grid.around(mesh, 24, margin=0.4))
    surface = field.to_mesh(0.2, method="dual", mesh=index)
    assert_closed_manifold(surface)
    away = sdm.signed_distance(mesh, surface.vertices)
    torch.testing.assert_close(away, torch.full_like(away, 0.2), rtol=0, atol=0.25 * field.grid.spacing[0])


def test_a_band_has_the_same_surface():
    mesh = box()
    grid = sdm.Grid.around(mesh, 30, margin=0.2)
    dense = sdm.signed_distance_map(mesh, grid).to_mesh(method="dual", mesh=mesh)
    band = sdm.narrow_band(mesh, grid).to_mesh(method="dual", mesh=mesh)
    assert torch.equal(dense.faces, band.faces)
    assert torch.equal(dense.vertices, band.vertices)


def test_what_cannot_be_is_refused():
    field = sdm.signed_distance_map(box(), 16)
    with pytest.raises(SDMError, match="use 'cubes'"):
        field.to_mesh(method="triple")
    with pytest.raises(SDMError, match="method='dual'"):
        field.to_mesh(mesh=box())
    with pytest.raises(SDMError, match="no surface at level 5"):
        field.to_mesh(5.0, method="dual")


def test_on_a_cpu_no_gpu_is_looked_for(monkeypatch):
    """Edges are sharpened, and surfaces compared, where the map is: not on whichever GPU the machine has."""

    def refused():
        raise AssertionError("a device was chosen by default")

    mesh = box()
    field = sdm.signed_distance_map(mesh, sdm.Grid.around(mesh, 24, margin=0.2), device="cpu")
    monkeypatch.setattr(torch.cuda, "is_available", refused)
    deviation(field.to_mesh(method="dual", mesh=mesh), mesh, samples=100)


@pytest.mark.gpu
def test_a_gpu_gives_the_same_surface():
    mesh = box()
    field = sdm.signed_distance_map(mesh, sdm.Grid.around(mesh, 40, margin=0.2), device="cpu")
    for given in (None, mesh):
        host = field.to_mesh(method="dual", mesh=given)
        there = field.to("cuda").to_mesh(method="dual", mesh=given)
        assert_edges_cancel(there.numpy()[1], len(there.vertices))
        # A diagonal may be the other one where both are as near.
        assert len(host) == len(there)
        torch.testing.assert_close(host.vertices, there.vertices.cpu(), rtol=1e-4, atol=1e-3 * field.grid.spacing[0])
