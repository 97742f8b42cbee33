from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere
from sdm.engine.band import band_slabs, near_blocks
from sdm.errors import GridError, SDMError


def mesh() -> sdm.TriangleMesh:
    return sdm.TriangleMesh(*sphere(10))


def opened() -> sdm.TriangleMesh:
    """A sphere with a large hole."""
    vertices, faces = sphere(10)
    return sdm.TriangleMesh(vertices, faces[vertices[faces].mean(1)[:, 2] < 0.4])


def assert_is_the_band(band: sdm.SparseSDM, dense: sdm.SDM) -> None:
    """The blocks that have a voxel in the band, and no others, with the dense map's bits."""
    near = dense.values.abs() < band.width
    wanted = torch.unique(near.nonzero() // 8, dim=0)
    assert torch.equal(band.blocks.long(), wanted)
    found = band.to_dense().values
    stored = torch.zeros_like(near)
    for x, y, z in (8 * wanted).tolist():
        stored[x : x + 8, y : y + 8, z : z + 8] = True
    assert torch.equal(found[stored], dense.values.clamp(-band.width, band.width)[stored])


@pytest.mark.parametrize("sign", ["winding", "none"])
@pytest.mark.parametrize("half_width", [1.5, 3.0, 7.3])
def test_values_are_the_dense_map(device, sign, half_width):
    grid = sdm.Grid.around(mesh(), 50)
    band = sdm.narrow_band(mesh(), grid, half_width=half_width, sign=sign, device=device)
    dense = sdm.signed_distance_map(mesh(), grid, sign=sign, device=device)
    assert_is_the_band(band, dense)
    assert torch.equal(band.to_dense().values, dense.values.clamp(-band.width, band.width))
    assert band.ambiguous_voxels == (0 if sign == "winding" else None)
    assert band.sign == sign


def test_a_grid_that_the_mesh_reaches_beyond(device):
    """From within, where no voxel is near the surface; and half of it."""
    for grid in (
        sdm.Grid((-0.2, -0.2, -0.2), (0.02,) * 3, (20, 20, 20)),
        sdm.Grid((0, 0.1, -2), (0.03,) * 3, (30, 50, 90)),
    ):
        band = sdm.narrow_band(mesh(), grid, device=device)
        dense = sdm.signed_distance_map(mesh(), grid, device=device)
        assert torch.equal(band.to_dense().values, dense.values.clamp(-band.width, band.width))


def test_an_open_mesh(device):
    grid = sdm.Grid.around(opened(), 45)
    band = sdm.narrow_band(opened(), grid, device=device)
    dense = sdm.signed_distance_map(opened(), grid, device=device)
    assert_is_the_band(band, dense)
    assert 0 < (band.ambiguous_voxels or 0) < (dense.ambiguous_voxels or 0)
    # Far from the surface a block has one sign.
    differ = (band.to_dense().values < 0) != (dense.values < 0)
    assert differ.float().mean() < 0.03


def test_grids_that_are_described():
    by_number = sdm.narrow_band(mesh(), 40, device="cpu")
    assert by_number.grid == sdm.Grid.around(mesh(), 40)
    assert sdm.narrow_band(mesh(), resolution=40, device="cpu").grid == by_number.grid
    by_length = sdm.narrow_band(mesh(), 0.1, device="cpu")
    assert by_length.grid.spacing == (0.1,) * 3 == sdm.narrow_band(mesh(), spacing=0.1, device="cpu").grid.spacing
    # All of the band is there.
    outermost = by_length.to_dense().values
    assert (outermost[0] == by_length.width).all()
    assert (outermost[..., -1] == by_length.width).all()
    assert by_length.half_width == pytest.approx(3.0)
    index = sdm.MeshIndex(mesh(), "cpu")
    assert torch.equal(index.narrow_band(0.1).values, by_length.values)


def test_lists_of_meshes():
    meshes = [mesh(), opened()]
    bands = sdm.narrow_band(meshes, 0.15, device="cpu")
    assert [band.grid for band in bands] == [sdm.narrow_band(one, 0.15, device="cpu").grid for one in meshes]
    grids = [band.grid for band in bands]
    again = sdm.narrow_band(meshes, grids, device="cpu")
    assert all(torch.equal(one.values, other.values) for one, other in zip(bands, again, strict=True))
    with pytest.raises(GridError, match="2 meshes and 1 grids"):
        sdm.narrow_band(meshes, grids[:1], device="cpu")


def test_a_mesh_far_from_its_grid():
    band = sdm.narrow_band(mesh(), sdm.Grid((50, 50, 50), (1, 1, 1), (9, 9, 9)), device="cpu")
    assert len(band) == 0
    assert (band.to_dense().values == 3.0).all()
    assert band.sample([[52.0, 52, 52]]).tolist() == [3.0]


def test_memory_grows_with_the_surface():
    """A small sphere in 2048^3 voxels, of which 32 layers alone would be 512 MiB."""
    place = Path("/proc/self/status")
    if not place.is_file():
        pytest.skip("needs the memory of the process from Linux")

    def used(name: str) -> int:
        return next(int(row.split()[1]) for row in place.read_text().splitlines() if row.startswith(name)) // 1024

    grid = sdm.Grid((-32.0,) * 3, (1 / 32,) * 3, (2048,) * 3)
    # Kernels are loaded.
    sdm.narrow_band(mesh(), 0.2, device="cpu")
    Path("/proc/self/clear_refs").write_text("5")
    before = used("VmRSS")
    band = sdm.narrow_band(mesh(), grid, device="cpu")
    assert used("VmHWM") - before < 64
    assert 100 < len(band) < 600
    # Its place in the grid does not matter but for roundings of coordinates, of which there are none.
    alone = sdm.narrow_band(mesh(), sdm.Grid((-2.0,) * 3, (1 / 32,) * 3, (128,) * 3), device="cpu")
    assert torch.equal(band.blocks - 120, alone.blocks)
    assert torch.equal(band.values, alone.values)


def test_many_copies_of_a_triangle():
    """A CPU measures it once, and counts it as often as it is there."""
    whole = mesh()
    faces = torch.cat([whole.faces, *100 * [whole.faces[:3]]])
    crowded = sdm.TriangleMesh(whole.vertices, faces)
    index = sdm.MeshIndex(crowded, "cpu", warn=False)
    assert index._repeated is not None
    grid = sdm.Grid.around(crowded, 30)
    band = index.narrow_band(grid)
    assert_is_the_band(band, index.signed_distance_map(grid))


@pytest.mark.parametrize("case", ["closed", "open", "turned", "cut off"])
def test_more_blocks_than_one_slab_may_have(case, device, monkeypatch):
    """Slabs along x, one after the other, have the same bits."""
    made = opened() if case == "open" else mesh()
    grid = sdm.Grid.around(made, 150)
    if case == "turned":
        turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
        turn[:, 2] *= np.linalg.det(turn)
        grid = sdm.Grid(-turn @ np.full(3, 1.9), (0.03,) * 3, (128,) * 3, turn)
    elif case == "cut off":
        grid = sdm.Grid(grid.origin, grid.spacing, (90, *grid.shape[1:]))
    whole = sdm.narrow_band(made, grid, device=device)
    monkeypatch.setattr(band_slabs, "MOST_BLOCKS", 2 * len(whole) // 3)
    parts = sdm.narrow_band(made, grid, device=device)
    for name in ("blocks", "values", "inside"):
        assert torch.equal(getattr(parts, name), getattr(whole, name))
    assert parts.ambiguous_voxels == whole.ambiguous_voxels
    monkeypatch.setattr(band_slabs, "MOST_BLOCKS", 10)
    with pytest.raises(GridError, match="32 layers of a narrow band have more than 10 blocks"):
        sdm.narrow_band(made, grid, device=device)


def test_a_band_that_does_not_fit(monkeypatch):
    monkeypatch.setattr(near_blocks, "SMALL", 0)
    monkeypatch.setattr(near_blocks, "free_memory", lambda _: 1 << 10)
    with pytest.raises(GridError, match=r"needs 0\.\d GiB, but cpu has 0\.0 GiB free: choose larger voxels"):
        sdm.narrow_band(mesh(), 0.05, device="cpu")


def test_a_band_that_does_not_fit_by_far_is_refused_before_its_blocks_are_listed(monkeypatch):
    """A million voxels along an edge were listed for hours."""
    monkeypatch.setattr(near_blocks, "SMALL", 0)
    monkeypatch.setattr(near_blocks, "free_memory", lambda _: 1 << 22)
    with pytest.raises(GridError, match=r"of [\d,]+ blocks or more needs"):
        sdm.narrow_band(mesh(), resolution=1_000_000, device="cpu")


def test_vertices_that_ask_for_gradients():
    """Values are those of the mesh as it is; gradients go to points and values alone."""
    asking = sdm.TriangleMesh(mesh().vertices.clone().requires_grad_(), mesh().faces)
    band = sdm.narrow_band(asking, 0.15, device="cpu")
    assert not band.values.requires_grad
    assert torch.equal(band.values, sdm.narrow_band(mesh(), 0.15, device="cpu").values)


def test_a_mesh_that_moved():
    index = sdm.MeshIndex(mesh(), "cpu")
    index.update(1.3 * mesh().vertices)
    moved = sdm.TriangleMesh(1.3 * mesh().vertices, mesh().faces)
    assert torch.equal(index.narrow_band(0.15).values, sdm.narrow_band(moved, 0.15, device="cpu").values)


def test_one_warning_about_a_mesh_inside_out():
    turned = sdm.TriangleMesh(mesh().vertices, mesh().faces.flip(1))
    with pytest.warns(sdm.SDMWarning, match="inside out"):
        sdm.narrow_band(turned, 0.2, device="cpu")


def test_refused():
    with pytest.raises(SDMError, match="hole_size is the width of gaps"):
        sdm.narrow_band(mesh(), 0.1, hole_size=0.1, device="cpu")
    with pytest.raises(GridError, match=r"at least 1\.5"):
        sdm.narrow_band(mesh(), 0.1, half_width=1, device="cpu")
    with pytest.raises(GridError, match="needs one of these"):
        sdm.narrow_band(mesh(), device="cpu")
    with pytest.raises(GridError, match="needs one of these"):
        sdm.narrow_band(mesh(), 0.1, resolution=40, device="cpu")
    with pytest.raises(GridError, match="is no grid"):
        sdm.narrow_band(mesh(), cast("Any", "40"), device="cpu")
