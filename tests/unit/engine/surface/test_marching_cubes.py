"""Marching cubes: closed manifolds of any field, places and orientation, one order on every device."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.measure import marching_cubes

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance
from sdm.kernels.surface.cell_cases import cell_cases
from tests.helpers.closed_surface import areas_and_volume, assert_closed_manifold, assert_edges_cancel

RADIUS = 1.0


def sphere(count: int, device: str = "cpu") -> SDM:
    grid = Grid((-1.3, -1.25, -1.2), (2.7 / (count - 3),) * 3, (count, count - 1, count + 2))
    return SDM((grid.points().norm(dim=-1) - RADIUS).to(device), grid)


def with_border(values: np.ndarray, spacing=(1.0, 1.5, 2.0)) -> SDM:
    """A map with a layer of 1 around it."""
    return SDM(
        np.pad(values, 1, constant_values=1).astype(np.float32), Grid((0, 0, 0), spacing, np.add(values.shape, 2))
    )


@pytest.mark.parametrize("seed", range(40))
def test_noise_has_a_closed_manifold(seed):
    """White noise has every ambiguous case; blocks of eight voxels meet in the larger ones."""
    random = np.random.default_rng(seed)
    shape = (6, 6, 6) if seed % 4 else random.integers(1, 20, 3)
    assert_closed_manifold(with_border(random.normal(size=shape)).to_mesh())


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("level", [0.0, 0.5])
def test_values_of_exactly_the_level_are_outside(seed, level):
    values = np.random.default_rng(seed).integers(-1, 2, (6, 6, 6)) / 2
    mesh = with_border(values).to_mesh(level)
    assert_closed_manifold(mesh)
    at = mesh.numpy()[0] / (1.0, 1.5, 2.0)
    inside = np.argwhere(np.pad(values, 1, constant_values=1) < level)
    # Along an edge from an inside voxel, or in the middle of a cell.
    assert max(np.abs(inside - place).sum(1).min() for place in at) <= 1.5


def test_a_single_voxel_is_an_octahedron():
    mesh = with_border(np.full((1, 1, 1), -1.0), (1.0, 1.0, 1.0)).to_mesh()
    assert (len(mesh), len(mesh.vertices)) == (8, 6)
    assert areas_and_volume(mesh)[1] == pytest.approx(1 / 6)


def test_every_case_is_its_opposite_inside_out():
    """Joined inside corners are outside ones that are apart: so cases pair up, with as many loops."""
    cases = cell_cases()
    for inside in range(256):
        faces = int(cases.ambiguous[inside]).bit_count()
        assert cases.ambiguous[255 - inside] == cases.ambiguous[inside]
        for packed in range(1 << faces):
            other = cases.first[255 - inside] + ((1 << faces) - 1 - packed)
            assert cases.loops[cases.first[inside] + packed] == cases.loops[other]


def test_as_scikit_image_where_no_cell_is_ambiguous():
    field = sphere(30)
    mesh = field.to_mesh()
    index, faces, _, _ = marching_cubes(field.numpy(), 0.0, gradient_direction="descent")
    assert (len(mesh), len(mesh.vertices)) == (len(faces), len(index))
    theirs = index * field.grid.spacing + field.grid.origin
    ours = mesh.numpy()[0]
    assert np.abs(np.sort(ours, axis=0) - np.sort(theirs, axis=0)).max() < 1e-4
    assert float(signed_distance(mesh, theirs, sign="none").max()) < 1e-4
    a, b, c = np.moveaxis(theirs[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert areas_and_volume(mesh)[0].sum() == pytest.approx(area, rel=1e-4)


def test_the_error_of_a_sphere_falls_with_the_square_of_the_voxel():
    errors = []
    for count in (20, 40):
        mesh = sphere(count).to_mesh()
        assert_closed_manifold(mesh)
        errors.append(abs(areas_and_volume(mesh)[1] / (4 / 3 * np.pi) - 1))
    assert errors[1] < errors[0] / 3


def test_a_surface_that_meets_the_border_ends_there():
    grid = Grid((0, 0, 0), (1, 1, 1), (9, 9, 9))
    mesh = SDM(grid.points()[..., 0] - 4.5, grid).to_mesh()
    assert len(mesh) == 2 * 8 * 8
    np.testing.assert_allclose(mesh.numpy()[0][:, 0], 4.5)


def test_values_that_are_not_finite_make_no_vertex_that_is_not():
    values = np.ones((5, 5, 5), np.float32)
    values[2, 2, 2] = -np.inf
    values[2, 2, 1] = values[3, 2, 2] = np.nan
    mesh = SDM(values, Grid((0, 0, 0), (1, 1, 1), (5, 5, 5))).to_mesh()
    assert np.isfinite(mesh.numpy()[0]).all()
    assert_edges_cancel(mesh.numpy()[1], len(mesh.vertices))


def test_order_is_that_of_blocks_whatever_runs_them(monkeypatch):
    whole = sphere(40).to_mesh()
    monkeypatch.setenv("SDM_NUM_THREADS", "1")
    alone = sphere(40).to_mesh()
    assert torch.equal(whole.vertices, alone.vertices)
    assert torch.equal(whole.faces, alone.faces)


def test_maps_of_other_types_and_with_gradients():
    field = sphere(20)
    doubled = SDM(field.values.double().requires_grad_(), field.grid)
    assert torch.equal(doubled.to_mesh().vertices, field.to_mesh().vertices)


@pytest.mark.gpu
def test_a_gpu_gives_the_same_mesh():
    noise = with_border(np.random.default_rng(3).normal(size=(30, 21, 17)))
    for field in (sphere(70), noise):
        host, there = field.to_mesh(), field.to("cuda").to_mesh()
        assert there.device.type == "cuda"
        assert torch.equal(host.faces, there.faces.cpu())
        torch.testing.assert_close(host.vertices, there.vertices.cpu(), rtol=1e-6, atol=1e-6)
