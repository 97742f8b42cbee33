"""Narrow bands on a GPU: the dense map's bits, memory that grows with the surface, few waits."""

from __future__ import annotations

from contextlib import contextmanager
from unittest import mock

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.engine.band import repeated_bands
from sdm.engine.plan_override import plan_override
from sdm.runtime import graphs

pytestmark = pytest.mark.gpu


def mesh(name: str) -> sdm.TriangleMesh:
    case = load_case(name)
    return sdm.TriangleMesh(case.vertices, case.faces, name).to("cuda")


@pytest.mark.parametrize(
    "name", ["torus", "needle box", "open hemisphere", "touching cubes", "random soup", "torus-90000"]
)
@pytest.mark.parametrize("resolution", [40, 150, 300])
def test_values_are_the_dense_map(name, resolution):
    """Of cells of 8 and of 16 voxels, coarse bricks and fine meshes."""
    made = mesh(name)
    grid = sdm.Grid.around(made, resolution)
    index = sdm.MeshIndex(made, "cuda", warn=False)
    band, dense = index.narrow_band(grid), index.signed_distance_map(grid)
    clamped = dense.values.clamp(-band.width, band.width)
    near = clamped.abs() < band.width
    assert torch.equal(band.blocks.long(), torch.unique(near.nonzero() // 8, dim=0))
    blocks = band.blocks.long()
    at = 8 * blocks[:, None] + torch.cartesian_prod(*3 * [torch.arange(8, device="cuda")])
    within = (at < torch.tensor(grid.shape, device="cuda")).all(-1)
    wanted = clamped[tuple(at[within].unbind(-1))]
    assert torch.equal(band.values.reshape(len(band), -1)[within], wanted)
    if index.closed:
        assert torch.equal(band.to_dense().values, clamped)


@pytest.mark.parametrize("turned", [False, True])
def test_uneven_grids(turned):
    made = mesh("torus")
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0] if turned else np.eye(3)
    turn[:, 2] *= np.linalg.det(turn)
    spacing, shape = np.array([0.02, 0.035, 0.05]), np.array([150, 91, 60])
    grid = sdm.Grid(-turn @ (spacing * (shape - 1) / 2), spacing, shape, turn)
    band = sdm.narrow_band(made, grid, half_width=2.5)
    dense = sdm.signed_distance_map(made, grid)
    assert torch.equal(band.to_dense().values, dense.values.clamp(-band.width, band.width))


@pytest.mark.parametrize("name", ["torus", "torus-1000000"])
def test_memory_grows_with_the_surface(name, whole_gpu):
    made = mesh(name)
    sdm.narrow_band(made, 64)
    torch.cuda.synchronize()
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    band = sdm.narrow_band(made, 2048)
    assert band.values.is_cuda
    # A dense map would be 32 GiB.
    assert torch.cuda.max_memory_allocated() - before < 4 << 30


def test_a_volume_of_warp():
    band = sdm.narrow_band(mesh("torus"), 128)
    # A volume's array does not keep the volume.
    volumes = band.to_warp(), band.cpu().to_warp()
    there, here = (volume.array().numpy() for volume in volumes)
    assert there.shape == here.shape
    # Leaves may lie in another order; what is active is not another.
    assert np.array_equal(there[672 + 56 : 672 + 64], here[672 + 56 : 672 + 64])


def moved(made: sdm.TriangleMesh, seed: int) -> sdm.TriangleMesh:
    """The mesh in new memory, a little smaller."""
    share = np.random.default_rng(seed).uniform(0.93, 1.0, 3)
    vertices = made.vertices * torch.tensor(share, dtype=torch.float32, device="cuda")
    return sdm.TriangleMesh(vertices, made.faces.clone(), check=False)


def assert_same_bands(one: sdm.SparseSDM, other: sdm.SparseSDM) -> None:
    for name in ("blocks", "values", "inside"):
        assert torch.equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("name", ["torus", "touching cubes", "torus-90000"])
@pytest.mark.parametrize("resolution", [40, 200])
def test_bands_of_a_kind_are_replayed(name, resolution):
    """With the bits of those made step by step, of meshes that are not those that were recorded."""
    graphs.clear()
    made = mesh(name)
    grid = sdm.Grid.around(made, resolution)
    # A small one is searched voxel by voxel otherwise, which is not recorded.
    with replay_count() as count, plan_override(method="cells"):
        for seed in range(6):
            one = moved(made, seed)
            found = sdm.narrow_band(one, grid)
            with graphs.paused():
                assert_same_bands(found, sdm.narrow_band(one, grid))
    # Of cubes that are stretched, one may need more than the room of the recording.
    assert 6 - graphs.CALLS - (name == "touching cubes") <= len(count) <= 6 - graphs.CALLS
    # A wrong guess: more blocks than there is room for, an open mesh, and one that reaches beyond the grid.
    larger = sdm.TriangleMesh(1.04 * made.vertices, made.faces.clone(), check=False)
    opened = sdm.TriangleMesh(made.vertices, torch.cat([made.faces[1:], made.faces[1:2]]), check=False)
    for one in (larger, opened):
        found = sdm.narrow_band(one, grid)
        with graphs.paused():
            assert_same_bands(found, sdm.narrow_band(one, grid))
    graphs.clear()


@contextmanager
def replay_count():
    """A list that has an entry for each band that was replayed."""
    found: list[int] = []
    plain = repeated_bands.finish_band

    def finish(*given):
        made = plain(*given)
        if made is not None:
            found.append(1)
        return made

    with mock.patch.object(repeated_bands, "finish_band", finish):
        yield found
