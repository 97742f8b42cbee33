from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere
from sdm.core.block_lookup import gaps_of
from sdm.errors import GridError, SDMError

GRID = sdm.Grid((-1.3, -1.2, -1.4), (0.05, 0.06, 0.07), (53, 41, 44))


@pytest.fixture(scope="module")
def dense() -> sdm.SDM:
    return sdm.signed_distance_map(sdm.TriangleMesh(*sphere(12)), GRID, device="cpu")


@pytest.fixture(scope="module")
def band() -> sdm.SparseSDM:
    return sdm.narrow_band(sdm.TriangleMesh(*sphere(12)), GRID, device="cpu")


def test_dense_values_of_a_box(band, dense):
    clamped = dense.values.clamp(-band.width, band.width)
    assert torch.equal(band.to_dense().values, clamped)
    part = band.to_dense(((5, 8, 3), (30, 33, 44)))
    assert torch.equal(part.values, clamped[5:30, 8:33, 3:44])
    assert np.allclose(part.grid.origin, np.array(GRID.origin) + np.array(GRID.spacing) * [5, 8, 3])
    with pytest.raises(GridError, match="no part of a grid"):
        band.to_dense(((0, 0, 0), (54, 1, 1)))


def test_single_voxels_and_blocks(band, dense):
    voxels = torch.stack(torch.meshgrid(*(torch.arange(n, device="cpu") for n in GRID.shape), indexing="ij"), -1)
    assert torch.equal(band.at(voxels), dense.values.clamp(-band.width, band.width))
    assert band.find(band.blocks).tolist() == list(range(len(band)))
    assert band.find(torch.tensor([[0, 0, 0], [-1, 0, 0], [99, 0, 0]], device="cpu")).tolist() == [-1, -1, -1]


@pytest.mark.parametrize("order", [1, 3])
def test_interpolation_and_its_gradient(band, order):
    """Near a sphere, between voxels well within the band."""
    rng = np.random.default_rng(0)
    way = rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    points = (way * rng.uniform(0.95, 1.0, (500, 1))).astype(np.float64)
    truth = sdm.signed_distance(sdm.TriangleMesh(*sphere(12)), points, device="cpu")
    assert (band.sample(points, order) - truth).abs().max() < 0.02
    slope = band.gradient(points, order)
    assert (slope * torch.from_numpy(way)).sum(1).mean() > 0.97
    tensor = torch.from_numpy(points[:20]).requires_grad_()
    values = band.values.double().requires_grad_()
    varied = band.with_values(values)
    assert torch.autograd.gradcheck(lambda p: varied.sample(p, order), tensor, atol=1e-6)
    varied.sample(tensor, order).sum().backward()
    assert values.grad is not None
    assert abs(float(values.grad.sum()) - 20) < 1e-9


@pytest.mark.parametrize("order", [1, 3])
def test_interpolation_is_that_of_the_dense_map(band, order):
    points = torch.from_numpy(np.random.default_rng(1).uniform(-1.5, 1.5, (2000, 3)))
    there, here = band.to_dense().sample(points, order), band.sample(points, order)
    assert torch.equal(there.isnan(), here.isnan())
    assert here.isnan().any()
    assert torch.allclose(there, here, atol=1e-7, equal_nan=True)


def test_cubic_interpolation_keeps_quadratics(band):
    """Of values that are a quadratic function of place, inside the grid."""
    full = sdm.narrow_band(sdm.TriangleMesh(*sphere(6)), GRID, half_width=40, device="cpu")
    at = (full.blocks[:, None].long() * 8 + torch.cartesian_prod(*3 * [torch.arange(8, device="cpu")])).double()
    step, origin = (torch.tensor(v, dtype=torch.float64, device="cpu") for v in (GRID.spacing, GRID.origin))
    place = at * step + origin
    x, y, z = place.unbind(-1)
    varied = full.with_values((x * x - 2 * y * z + 3 * z + y).reshape(full.values.shape))
    points = torch.from_numpy(np.random.default_rng(2).uniform(-1.0, 1.0, (300, 3)))
    x, y, z = points.unbind(-1)
    assert torch.allclose(varied.sample(points, 3), x * x - 2 * y * z + 3 * z + y, atol=1e-12)


def test_gaps_cover_what_is_not_stored():
    count = 3, 2, 5
    keys = torch.tensor([0, 3, 9, 20, 21, 22, 23, 24], device="cpu")
    begin, end = gaps_of(keys, count)
    assert list(zip(begin.tolist(), end.tolist(), strict=True)) == [(1, 3), (4, 5), (5, 9)]


def test_refused(band):
    with pytest.raises(SDMError, match="order is 2"):
        band.sample([[0.0, 0, 0]], 2)
    with pytest.raises(GridError, match="is needed"):
        band.sample([[0.0, 0]])
    with pytest.raises(GridError, match="values for"):
        sdm.SparseSDM(band.blocks[1:], band.values, band.inside, GRID, 0.1)


def test_torch_keeps_it(band, tmp_path):
    torch.save(band, tmp_path / "band.pt")
    again = torch.load(tmp_path / "band.pt")
    assert torch.equal(again.values, band.values)
    assert again.grid == GRID
    assert again.width == band.width
