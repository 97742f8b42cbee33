# Kernels are typed by Warp's rules.
# pyright: reportInvalidTypeForm=false
from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

import sdm
from sdm.bench.common.meshes import sphere
from sdm.core.block_lookup import blocks_along, joined_runs
from sdm.errors import FormatError
from sdm.io import load_band
from sdm.kernels.nanovdb import lookup

ENDINGS = ("npz", "zarr", "nvdb")
TURN = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]


def grid(step: float = 0.035) -> sdm.Grid:
    return sdm.Grid((-1.2, -1.3, -1.1), (step, 1.1 * step, step), (69, 71, 62))


def band(where: sdm.Grid | None = None, half_width: float = 1.5) -> sdm.SparseSDM:
    return sdm.narrow_band(sdm.TriangleMesh(*sphere(12)), where or grid(), half_width=half_width, device="cpu")


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_is_written_is_read(ending, tmp_path):
    for number, made in enumerate(
        (
            band(),
            band(sdm.Grid((0.1, 0.2, 0), (0.03, 0.05, 0.04), (40, 30, 33), TURN)),
            # Nothing is near: outside of all, and inside.
            band(sdm.Grid((5, 5, 5), (0.1,) * 3, (9, 9, 9))),
            band(sdm.Grid((-0.2,) * 3, (0.02,) * 3, (20, 9, 17))),
        )
    ):
        path = tmp_path / f"{number}.{ending}"
        made.save(path)
        found = sdm.load(path)
        assert isinstance(found, sdm.SparseSDM)
        for name in ("blocks", "values", "inside"):
            assert torch.equal(getattr(found, name), getattr(made, name)), name
        assert (found.grid, found.width, found.sign) == (made.grid, made.width, made.sign)
        assert found.ambiguous_voxels == made.ambiguous_voxels
        assert torch.equal(load_band(path).values, made.values)
    assert len(band().inside) > 0


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_flood_keeps_its_hole_size(ending, tmp_path):
    made = sdm.narrow_band(sdm.TriangleMesh(*sphere(6)), 0.2, sign="flood", hole_size=0.3, device="cpu")
    made.save(tmp_path / f"band.{ending}")
    found = sdm.load(tmp_path / f"band.{ending}")
    assert (found.sign, found.hole_size) == ("flood", 0.3)
    assert torch.equal(found.inside, made.inside)
    assert found.to_dense().hole_size == 0.3


@pytest.mark.parametrize("ending", ENDINGS)
def test_maps_are_no_bands_and_may_take_their_place(ending, tmp_path):
    field = sdm.signed_distance_map(sdm.TriangleMesh(*sphere(6)), 20, device="cpu")
    path = tmp_path / f"there.{ending}"
    band().save(path)
    field.save(path)
    assert isinstance(sdm.load(path), sdm.SDM)
    with pytest.raises(FormatError, match="has no narrow band"):
        load_band(path)
    band().save(path)
    assert isinstance(sdm.load(path), sdm.SparseSDM)


@pytest.mark.parametrize("ending", ENDINGS)
def test_damage_is_told(ending, tmp_path):
    path = tmp_path / f"band.{ending}"
    band().save(path)
    part = next(path.glob("values/c/*/*/*/*")) if ending == "zarr" else path
    data = bytearray(part.read_bytes())
    data[len(data) // 2] ^= 0xFF
    part.write_bytes(data)
    with pytest.raises(FormatError):
        sdm.load(path)


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(FormatError, match="no place for a narrow band"):
        band().save(tmp_path / "band.nii.gz")


def test_warp_looks_up_every_voxel(device):
    """In a volume with leaves, and tiles inside and outside, of two sizes."""
    made = sdm.narrow_band(sdm.TriangleMesh(*sphere(20)), grid(0.011), half_width=1.5, device="cpu").to(device)
    # So large that a lower node lies within.
    wide = sdm.narrow_band(
        sdm.TriangleMesh(*sphere(12)), sdm.Grid((-1.1,) * 3, (2.2 / 419,) * 3, (420,) * 3), half_width=1.5, device="cpu"
    ).to(device)
    for some, box in ((made, None), (wide, ((128, 130, 100), (290, 150, 300)))):
        volume = some.to_warp()
        dense = some.to_dense(box)
        first = (0, 0, 0) if box is None else box[0]
        shape = dense.shape if box is None else box[1]
        values = wp.zeros((shape[0] - first[0], shape[1], shape[2]), dtype=wp.float32, device=volume.device)
        lookup(volume, first[0], values)
        found = torch.from_numpy(values.numpy())[:, first[1] :, first[2] :]
        assert torch.equal(found, dense.values.cpu())
        assert (found < 0).any()


def test_active_voxels_are_counted(tmp_path):
    made = band()
    # Kept: its array has no hold on its memory.
    volume = made.to_warp()
    data = volume.array().numpy()
    assert int(data[672 + 56 : 672 + 64].view(np.uint64)[0]) == made.active_voxels


def test_runs_that_follow_each_other_are_one():
    count = blocks_along((16, 16, 80))
    runs = torch.tensor(
        [[0, 1, 4, 6], [0, 0, 0, 2], [0, 0, 2, 3], [0, 0, 5, 10], [0, 1, 0, 4]], dtype=torch.int32, device="cpu"
    )
    assert joined_runs(runs, count).tolist() == [[0, 0, 0, 3], [0, 0, 5, 10], [0, 1, 0, 6]]
    assert joined_runs(runs[:0], count).shape == (0, 4)
