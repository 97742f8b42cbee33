from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import GridError, SDMError
from sdm.io import load

CENTRE = np.array([0.3, -0.2, 0.1])


def ball(direction: np.ndarray, spacing=(0.1, 0.1, 0.1), shape=(27, 27, 27)) -> SDM:
    """A ball of radius 1 about CENTRE, in the middle of a turned grid."""
    half = (np.asarray(shape) - 1) / 2 * spacing
    grid = Grid(CENTRE - direction @ half, spacing, shape, direction)
    return SDM((grid.points() - torch.tensor(CENTRE, dtype=torch.float32)).norm(dim=-1) - 1, grid)


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


TURNS = {
    "straight": np.eye(3),
    "turned": np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0],
    "mirrored": np.diag([1.0, -1.0, 1.0]),
    "swapped": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("turn", TURNS)
def test_the_surface_faces_outward_and_lies_where_it_should(turn):
    vertices, faces = ball(TURNS[turn]).to_mesh().numpy()
    np.testing.assert_allclose(np.linalg.norm(vertices - CENTRE, axis=1), 1, atol=2e-3)
    assert signed_volume(vertices - CENTRE, faces) == pytest.approx(4 / 3 * np.pi, rel=0.01)


def test_unequal_voxels():
    field = ball(np.eye(3), (0.05, 0.1, 0.2), (53, 27, 14))
    vertices, faces = field.to_mesh().numpy()
    assert signed_volume(vertices - CENTRE, faces) == pytest.approx(4 / 3 * np.pi, rel=0.02)


@pytest.mark.parametrize("level", [-0.4, 0.2])
def test_another_level_is_a_ball_of_another_size(level):
    vertices = ball(np.eye(3)).to_mesh(level).numpy()[0]
    np.testing.assert_allclose(np.linalg.norm(vertices - CENTRE, axis=1), 1 + level, atol=4e-3)


def test_no_surface_is_said():
    with pytest.raises(SDMError, match="no surface at level 5"):
        ball(np.eye(3)).to_mesh(5.0)
    flat = Grid((0, 0, 0), (1, 1, 1), (4, 4, 1))
    with pytest.raises(SDMError, match="one voxel thin"):
        SDM(torch.linspace(-1, 1, 16).reshape(4, 4, 1), flat).to_mesh()


def test_values_must_fit_the_grid():
    with pytest.raises(GridError, match="do not fit"):
        SDM(torch.zeros(2, 2, 2), Grid((0, 0, 0), (1, 1, 1), (2, 2, 3)))


def test_values_of_numpy(tmp_path):
    """A map that somebody computed otherwise is saved and read as any other, in whatever order its memory is."""
    grid = Grid((0, 0, 0), (1, 2, 1), (2, 3, 4))
    values = np.asfortranarray(np.arange(24.0).reshape(2, 3, 4) - 7.5)
    field = SDM(values, grid)
    assert field.values.dtype == torch.float32
    field.save(tmp_path / "map.nii.gz")
    np.testing.assert_array_equal(load(tmp_path / "map.nii.gz").numpy(), values)
    values[:] = 0
    assert field.numpy()[0, 0, 0] == -7.5
    with pytest.raises(SDMError, match="real numbers, not complex128"):
        SDM(values * 1j, grid)


def test_numpy_detaches():
    values = torch.zeros(1, 1, 1, requires_grad=True)
    assert SDM(values, Grid((0, 0, 0), (1, 1, 1), (1, 1, 1))).numpy().tolist() == [[[0.0]]]


@pytest.mark.parametrize("kind", [torch.bfloat16, torch.float16, torch.float64])
def test_values_of_another_type_come_out_as_float32(kind, tmp_path):
    field = ball(np.eye(3), shape=(3, 4, 5))
    other = SDM(field.values.to(kind), field.grid)
    assert other.numpy().dtype == np.float32
    for ending in ("nii", "npz", "nrrd", "zarr", "nvdb"):
        other.save(tmp_path / f"map.{ending}")
        torch.testing.assert_close(sdm.load(tmp_path / f"map.{ending}").values, other.values.float(), rtol=0, atol=0)
