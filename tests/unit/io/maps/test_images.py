"""Exchange with other software: files that it reads, and files that it wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nibabel as nib
import nrrd
import numpy as np
import pytest
import torch

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, GridError
from sdm.io import grid_like, load, save
from sdm.io.files import nifti_stream
from sdm.io.maps import nifti

TURN = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
GRID = Grid((-50.3, 20.1, 3), (0.7, 0.8, 1.9), (6, 7, 10), TURN)


def opened(path: Path) -> Any:
    return nib.load(path)  # pyright: ignore[reportPrivateImportUsage]


@pytest.fixture
def field() -> SDM:
    values = np.random.default_rng(0).normal(size=GRID.shape).astype(np.float32)
    return SDM(torch.from_numpy(values), GRID, 1)


@pytest.mark.parametrize("ending", ["nii", "nii.gz"])
def test_nifti_as_others_see_it(field, ending, tmp_path):
    save(field, tmp_path / f"map.{ending}")
    image = opened(tmp_path / f"map.{ending}")
    assert image.get_data_dtype() == np.float32
    for affine, code in (image.get_sform(coded=True), image.get_qform(coded=True)):
        assert code == 1
        np.testing.assert_allclose(affine, GRID.affine, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(np.asarray(image.dataobj), field.numpy())
    assert image.header.get_xyzt_units()[0] == "mm"
    np.testing.assert_allclose(image.header.get_zooms(), GRID.spacing, rtol=1e-6)


def test_an_affine_that_someone_edits_wins(field, tmp_path):
    save(field, tmp_path / "map.nii")
    image = opened(tmp_path / "map.nii")
    moved = GRID.affine.copy()
    moved[0, 3] += 0.01
    image.set_sform(moved)
    nib.save(image, tmp_path / "moved.nii")
    again = load(tmp_path / "moved.nii")
    assert again.grid.origin[0] == pytest.approx(GRID.origin[0] + 0.01, abs=1e-5)
    assert again.ambiguous_voxels is None


def test_a_crop_by_other_software_keeps_its_own_geometry(field, tmp_path):
    save(field, tmp_path / "map.nii.gz")
    cropped = opened(tmp_path / "map.nii.gz").slicer[1:4, 2:, :]
    nib.save(cropped, tmp_path / "crop.nii.gz")
    again = load(tmp_path / "crop.nii.gz")
    np.testing.assert_array_equal(again.numpy(), field.numpy()[1:4, 2:])
    np.testing.assert_allclose(again.grid.affine, cropped.affine, atol=1e-5)


def test_an_image_of_other_software(tmp_path):
    affine = np.diag([-0.5, 0.5, 2.0, 1.0])
    affine[:3, 3] = (10, -20, 30)
    image = nib.Nifti1Image(np.arange(24, dtype=np.int16).reshape(2, 3, 4, 1), affine)
    image.header.set_slope_inter(2.0, 1.0)
    nib.save(image, tmp_path / "mri.nii.gz")
    grid = grid_like(tmp_path / "mri.nii.gz")
    assert (grid.spacing, grid.shape, grid.origin) == ((0.5, 0.5, 2.0), (2, 3, 4), (10.0, -20.0, 30.0))
    assert grid.direction[0] == (-1.0, 0.0, 0.0)
    expected = opened(tmp_path / "mri.nii.gz").get_fdata().reshape(2, 3, 4)
    np.testing.assert_array_equal(load(tmp_path / "mri.nii.gz").numpy(), expected)


def test_a_long_axis_needs_nifti_2(tmp_path):
    grid = Grid((0, 0, 0), (1, 1, 1), (40000, 1, 1))
    save(SDM(torch.zeros(grid.shape), grid), tmp_path / "long.nii")
    assert opened(tmp_path / "long.nii").header["sizeof_hdr"] == 540
    assert load(tmp_path / "long.nii").grid == grid


def test_nrrd_as_others_see_it(field, tmp_path):
    save(field, tmp_path / "map.nrrd")
    values, header = nrrd.read(str(tmp_path / "map.nrrd"))
    np.testing.assert_array_equal(values, field.numpy())
    assert header["space"] == "right-anterior-superior"
    np.testing.assert_allclose(header["space directions"], GRID.affine[:3, :3].T)
    np.testing.assert_allclose(header["space origin"], GRID.origin)


def test_nrrd_and_nifti_of_one_image_give_one_grid(tmp_path):
    affine = GRID.affine
    nib.save(nib.Nifti1Image(np.zeros(GRID.shape, np.float32), affine), tmp_path / "a.nii")
    flip = np.diag([-1.0, -1.0, 1.0])
    header = {
        "space": "left-posterior-superior",
        "space directions": (flip @ affine[:3, :3]).T,
        "space origin": flip @ affine[:3, 3],
    }
    nrrd.write(str(tmp_path / "a.nrrd"), np.zeros(GRID.shape, np.uint8), header)
    nrrd.write(str(tmp_path / "b.nhdr"), np.zeros(GRID.shape, np.uint8), header)
    for name in ("a.nii", "a.nrrd", "b.nhdr"):
        np.testing.assert_allclose(grid_like(tmp_path / name).affine, affine, atol=1e-5)
        assert grid_like(tmp_path / name).shape == GRID.shape


def test_a_nrrd_that_says_its_spacings_alone(tmp_path):
    nrrd.write(str(tmp_path / "a.nrrd"), np.ones((2, 3, 4), np.uint8), {"spacings": [1.0, 2.0, 3.0]})
    grid = grid_like(tmp_path / "a.nrrd")
    assert (grid.spacing, grid.origin, grid.shape) == ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (2, 3, 4))
    assert load(tmp_path / "a.nrrd").values.sum() == 24


def test_a_nrrd_that_begins_at_axis_mins_is_refused(tmp_path):
    nrrd.write(str(tmp_path / "a.nrrd"), np.ones((2, 3, 4), np.uint8), {"axis mins": [5.0, 6.0, 7.0]})
    with pytest.raises(FormatError, match=r"a\.nrrd says by axis mins where it begins"):
        grid_like(tmp_path / "a.nrrd")
    nrrd.write(str(tmp_path / "b.nrrd"), np.ones((2, 3, 4), np.uint8), {"axis mins": [np.nan] * 3})
    assert grid_like(tmp_path / "b.nrrd").origin == (0.0, 0.0, 0.0)


def test_complex_numbers_are_refused(tmp_path):
    nib.save(nib.Nifti1Image(np.ones((2, 3, 4), np.complex64), np.eye(4)), tmp_path / "a.nii")
    with pytest.raises(FormatError, match=r"a\.nii has values of type complex64: plain numbers are needed"):
        load(tmp_path / "a.nii")
    assert grid_like(tmp_path / "a.nii").shape == (2, 3, 4)


def test_images_of_other_dimensions_are_refused(tmp_path):
    nib.save(nib.Nifti1Image(np.zeros((2, 3, 4, 5), np.float32), np.eye(4)), tmp_path / "a.nii")
    nrrd.write(str(tmp_path / "a.nrrd"), np.zeros((2, 3, 4, 5), np.uint8))
    nrrd.write(str(tmp_path / "b.nrrd"), np.zeros((2, 3), np.uint8))
    for name in ("a.nii", "a.nrrd", "b.nrrd"):
        with pytest.raises(FormatError, match="three dimensions"):
            grid_like(tmp_path / name)


def test_a_sheared_image_is_refused(tmp_path):
    affine = np.eye(4)
    affine[0, 1] = 0.5
    nib.save(nib.Nifti1Image(np.zeros((2, 3, 4), np.float32), affine), tmp_path / "a.nii")
    with pytest.raises(GridError, match=r"a\.nii: .* shear"):
        grid_like(tmp_path / "a.nii")


@pytest.mark.parametrize("turned_at_once", [1, 400, 1 << 24])
def test_nifti_has_its_values_as_others_see_them(field, turned_at_once, monkeypatch):
    monkeypatch.setattr(nifti_stream, "TURNED", turned_at_once)
    head, values = nifti.planned(field, "a" * 32)
    found = b"".join(piece.tobytes() for piece in nifti_stream.pieces(head, values))
    assert found == head + values.tobytes(order="F")
    # Its header is that of `test_nifti_header`.
    image: Any = nib.Nifti1Image.from_bytes(found)
    np.testing.assert_array_equal(np.asanyarray(image.dataobj), values)
