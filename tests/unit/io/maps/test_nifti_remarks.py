"""Remarks of nibabel about headers: none is printed as it is, and one about lengths that were guessed is a warning."""

from __future__ import annotations

import struct
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

import sdm
from sdm.cli import main
from sdm.errors import SDMWarning


@pytest.fixture(params=["sform", "nothing"])
def odd(request, tmp_path) -> tuple[Path, bool]:
    """A label volume with a voxel size of 0, which counts where there is no sform."""
    image = nib.Nifti1Image(np.eye(4, dtype=np.uint8)[None].repeat(4, 0), np.eye(4))
    content = bytearray(image.to_bytes())
    content[80:92] = struct.pack("<3f", 2, 0, 2)
    if request.param == "nothing":
        # The codes of qform and sform.
        content[252:256] = bytes(4)
    path = tmp_path / "odd.nii"
    path.write_bytes(content)
    return path, request.param == "nothing"


def test_a_voxel_size_of_0_is_told_where_it_counts(odd, tmp_path, capfd):
    path, counts = odd
    assert main(["edt", str(path), "-o", str(tmp_path / "d.npz"), "--device", "cpu"]) == 0
    said = (
        f"sdm: warning: {path} has voxel sizes of (2, 0, 2): a size of 0 is read as 1, so that lengths may be wrong\n"
    )
    assert capfd.readouterr().err == (said if counts else "")
    if counts:
        with pytest.warns(SDMWarning, match="a size of 0 is read as 1"):
            sdm.load(path)


@pytest.mark.parametrize(
    ("unit", "said"), [("mm", None), ("unknown", None), ("micron", "micrometres"), ("meter", "metres")]
)
def test_an_image_in_another_unit_than_that_of_files_of_maps_is_told_of(unit, said, tmp_path, capfd):
    image = nib.Nifti1Image(np.eye(4, dtype=np.uint8)[None].repeat(4, 0), np.eye(4))
    image.header.set_xyzt_units(unit)
    nib.save(image, tmp_path / "labels.nii.gz")
    assert main(["edt", str(tmp_path / "labels.nii.gz"), "-o", str(tmp_path / "d.nii.gz"), "--device", "cpu"]) == 0
    err = capfd.readouterr().err
    assert (f"labels.nii.gz counts in {said}, and so do distances" in err) if said else err == ""


def test_several_volumes_in_one_file_are_to_be_parted(tmp_path, capfd):
    nib.save(nib.Nifti1Image(np.ones((4, 4, 4, 2), np.uint8), np.eye(4)), tmp_path / "two.nii.gz")
    assert main(["edt", str(tmp_path / "two.nii.gz"), "-o", str(tmp_path / "d.nii.gz")]) == 2
    assert "(4, 4, 4, 2); an image of three dimensions is needed; take one of its volumes" in capfd.readouterr().err
