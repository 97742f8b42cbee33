from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch

import sdm
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import GridError, SDMError
from sdm.io import load
from sdm.runtime.host_copy import number_later

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


def test_a_map_is_an_array():
    field = ball(np.eye(3), shape=(3, 4, 5))
    assert field.shape == (3, 4, 5)
    assert len(field) == 3
    np.testing.assert_array_equal(np.asarray(field), field.numpy())
    assert np.asarray(field, dtype=np.float64).dtype == np.float64
    assert np.abs(field).shape == (3, 4, 5)
    assert not np.shares_memory(np.array(field), field.numpy())
    assert torch.equal(field[1, :, 2], field.values[1, :, 2])
    assert field.cpu().grid == field.to("cpu").grid == field.grid
    with pytest.raises(ValueError, match="without a copy"):
        np.array(field, dtype=np.float64, copy=False)


def test_a_map_and_a_mesh_in_one_line():
    assert repr(ball(np.eye(3))) == "SDM(27 x 27 x 27 voxels of 0.1, on cpu)"
    field = SDM(torch.zeros(1, 2, 3), Grid((0, 0, 0), (1, 2, 3), (1, 2, 3)), 1234)
    assert repr(field) == "SDM(1 x 2 x 3 voxels of 1 x 2 x 3, 1,234 of them ambiguous, on cpu)"
    mesh = ball(np.eye(3)).to_mesh()
    assert repr(mesh) == f"TriangleMesh(isosurface: {len(mesh):,} triangles, {len(mesh.vertices):,} vertices, on cpu)"


@pytest.mark.parametrize("turn", TURNS)
def test_samples_are_trilinear(turn):
    """A trilinear function is met everywhere, and a voxel centre of the border exactly."""
    field = ball(TURNS[turn], shape=(6, 5, 4))
    points = field.grid.points().double()

    def polynomial(at: torch.Tensor) -> torch.Tensor:
        return 1 + at @ torch.tensor([2.0, -3, 0.5], dtype=torch.float64)

    linear = SDM(polynomial(points).float(), field.grid)
    weight = torch.rand(50, 8, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    corners = points[::5, ::4, ::3].reshape(1, 8, 3)
    inside = (weight / weight.sum(1, keepdim=True) * corners).sum(1)
    torch.testing.assert_close(linear.sample(inside), polynomial(inside).float(), rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(field.sample(points), field.values, rtol=1e-5, atol=1e-5)
    assert field.sample([[100.0, 0, 0], [np.nan, 0, 0]]).isnan().all()


def test_samples_have_gradients():
    grid = Grid((-1, 0, 2), (0.5, 1, 2), (3, 4, 2))
    generator = torch.Generator().manual_seed(1)
    values = torch.rand(3, 4, 2, dtype=torch.float64, generator=generator, requires_grad=True)
    low, size = torch.tensor([-1.0, 0, 2]), torch.tensor([1.0, 3, 2])
    points = (low + size * torch.rand(9, 3, generator=generator)).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda v, p: SDM(v, grid).sample(p), (values, points))


def test_samples_of_a_thin_grid():
    flat = SDM(torch.tensor([[[1.0], [3.0]]]), Grid((0, 0, 0), (1, 1, 1), (1, 2, 1)))
    assert flat.sample([0, 0.5, 0]).item() == 2
    assert flat.sample(np.zeros((2, 0, 3))).shape == (2, 0)
    with pytest.raises(GridError, match=r"\(2,\); \(\.\.\., 3\)"):
        flat.sample([1.0, 2.0])


def test_a_map_is_kept_by_torch(tmp_path):
    field = ball(np.eye(3), shape=(3, 4, 5))
    torch.save({"map": field}, tmp_path / "map.pt")
    for weights_only in (True, False):
        kept = torch.load(tmp_path / "map.pt", weights_only=weights_only)["map"]
        assert torch.equal(kept.values, field.values)
        assert (kept.grid, kept.ambiguous_voxels) == (field.grid, field.ambiguous_voxels)


def test_ambiguous_voxels_are_counted_when_they_are_first_asked_for():
    asked = []
    grid = Grid([0] * 3, [1] * 3, [2] * 3)
    field = SDM(torch.zeros(2, 2, 2), grid, 0).counted_later(lambda: asked.append(1) or 7)
    assert not asked
    moved = pickle.loads(pickle.dumps(field))
    assert (field.ambiguous_voxels, moved.ambiguous_voxels, field.truncate(1.0).ambiguous_voxels) == (7, 7, 7)
    assert len(asked) == 1
    assert number_later(torch.tensor([5]))() == 5
