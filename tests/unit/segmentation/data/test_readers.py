"""Both layouts of folders, and files that cannot be used."""

from __future__ import annotations

import gzip

import nibabel as nib
import numpy as np
import pytest
import torch

from sdm.errors import FormatError
from sdm.segmentation import has_part, read_cases
from sdm.segmentation.data.hdf5_cases import read_hdf5
from tests.helpers.segmentation_cases import AFFINE, volume, write_hdf5, write_nnunet


def test_nnunet_folders(tmp_path):
    folder = write_nnunet(tmp_path)
    cases = read_cases(folder, "train")
    assert [c.name for c in cases] == ["case0", "case1", "case2"]
    image, label = volume(1)
    assert torch.equal(cases[1].image, torch.from_numpy(image))
    assert cases[1].label is not None
    assert torch.equal(cases[1].label, torch.from_numpy(label != 0))
    assert cases[1].spacing == pytest.approx((0.8, 0.8, 1.25))
    assert np.array_equal(cases[1].affine, nib.load(folder / "imagesTr" / "case1_0000.nii.gz").affine)
    assert [c.name for c in read_cases(folder, "val")] == ["case3"]
    assert has_part(folder, "val")


def test_hdf5_folders(tmp_path):
    image, label = volume(0)
    write_hdf5(tmp_path / "train" / "a.h5", image, label, spacing=(1.0, 2.0, 3.0))
    write_hdf5(tmp_path / "val" / "b.h5", image.astype(np.int16), label)
    (case,) = read_cases(tmp_path, "train")
    assert case.name == "a"
    assert case.spacing == (1.0, 2.0, 3.0)
    assert case.label is not None
    assert case.label.dtype == torch.bool
    (other,) = read_cases(tmp_path, "val")
    assert other.image.dtype == torch.float32
    assert other.spacing == (1.0, 1.0, 1.0)


def test_hdf5_files_without_a_part_are_for_training(tmp_path):
    write_hdf5(tmp_path / "a.h5", *volume(0))
    assert len(read_cases(tmp_path, "train")) == 1
    assert not has_part(tmp_path, "val")


def broken_nifti(folder):
    path = folder / "imagesTr" / "case0_0000.nii.gz"
    path.write_bytes(path.read_bytes()[:400])


def missing_label(folder):
    (folder / "labelsTr" / "case0.nii.gz").unlink()


def coarser_label(folder):
    nib.save(nib.Nifti1Image(volume(0)[1], 2 * AFFINE), folder / "labelsTr" / "case0.nii.gz")


def moved_label(folder):
    affine = AFFINE.copy()
    affine[0, 3] += 3
    nib.save(nib.Nifti1Image(volume(0)[1], affine), folder / "labelsTr" / "case0.nii.gz")


def second_channel(folder):
    nib.save(nib.Nifti1Image(volume(0)[0], AFFINE), folder / "imagesTr" / "case0_0001.nii.gz")


def unnumbered(folder):
    (folder / "imagesTr" / "case0_0000.nii.gz").rename(folder / "imagesTr" / "case0.nii.gz")


def of_colours(folder):
    colours = np.zeros(volume(0)[0].shape, [(name, np.uint8) for name in "RGB"])
    nib.save(nib.Nifti1Image(colours, AFFINE), folder / "imagesTr" / "case0_0000.nii.gz")


def of_complex_numbers(folder):
    nib.save(nib.Nifti1Image(volume(0)[0] * 1j, AFFINE), folder / "imagesTr" / "case0_0000.nii.gz")


def of_no_type(folder):
    image = nib.Nifti1Image(volume(0)[0], AFFINE)
    data = bytearray(image.to_bytes())
    data[70:72] = b"\0\0"
    (folder / "imagesTr" / "case0_0000.nii.gz").write_bytes(gzip.compress(bytes(data)))


def label_twice(folder):
    nib.save(nib.Nifti1Image(volume(0)[1], AFFINE), folder / "labelsTr" / "case0.nii")


def image_twice(folder):
    nib.save(nib.Nifti1Image(volume(0)[0], AFFINE), folder / "imagesTr" / "case0_0000.nii")


BROKEN = {
    broken_nifti: "case0_0000.nii.gz cannot be read",
    missing_label: "case0_0000.nii.gz has no label",
    coarser_label: "case0.nii.gz has voxels of 1.6 x 1.6 x 2.5 mm, but its image of 0.8 x 0.8 x 1.25 mm",
    moved_label: "case0.nii.gz lies elsewhere in space",
    second_channel: "case0_0001.nii.gz is a second channel",
    unnumbered: "call it case0_0000.nii.gz",
    label_twice: "case0.nii and case0.nii.gz have one name: take one of them out",
    image_twice: "case0_0000.nii and case0_0000.nii.gz have one name",
    of_colours: "case0_0000.nii.gz has values of type .*: plain numbers are needed",
    of_complex_numbers: "case0_0000.nii.gz has values of type complex64: plain numbers are needed",
    of_no_type: "case0_0000.nii.gz cannot be read as NIfTI: data code 0 not supported",
}


@pytest.mark.parametrize("breaking", BROKEN, ids=lambda f: f.__name__)
def test_bad_nifti_files_are_named(tmp_path, breaking):
    folder = write_nnunet(tmp_path)
    breaking(folder)
    with pytest.raises(FormatError, match=BROKEN[breaking]):
        read_cases(folder, "train")


def test_nifti_2_is_nifti(tmp_path):
    image, label = volume(0)
    folder = write_nnunet(tmp_path, train=1)
    nib.save(nib.Nifti2Image(image, AFFINE), folder / "imagesTr" / "case0_0000.nii.gz")
    nib.save(nib.Nifti2Image(label, AFFINE), folder / "labelsTr" / "case0.nii.gz")
    (case,) = read_cases(folder, "train")
    assert torch.equal(case.image, torch.from_numpy(image))
    assert case.label is not None
    assert torch.equal(case.label, torch.from_numpy(label != 0))
    assert np.allclose(case.affine, AFFINE)


@pytest.mark.parametrize(("unit", "size"), [("mm", 1.0), ("meter", 1e-3), ("micron", 1e3)])
def test_lengths_are_millimetres_whatever_the_header_has(unit, size, tmp_path):
    """The label, of another program, is in mm."""
    folder = write_nnunet(tmp_path, train=1)
    scaled = nib.Nifti1Image(volume(0)[0], np.diag([size, size, size, 1]) @ AFFINE)
    scaled.header.set_xyzt_units(unit)
    nib.save(scaled, folder / "imagesTr" / "case0_0000.nii.gz")
    (case,) = read_cases(folder, "train")
    assert case.spacing == pytest.approx((0.8, 0.8, 1.25))
    assert np.allclose(case.affine, AFFINE)


def test_hidden_files_are_no_cases(tmp_path):
    """As macOS lays beside others where a disk or an archive keeps no attributes."""
    folder = write_nnunet(tmp_path / "nifti")
    for name in ("imagesTr/._case0_0000.nii.gz", "labelsTr/._case0.nii.gz"):
        (folder / name).write_bytes(b"\0\5\x16\7")
    assert len(read_cases(folder, "train")) == 3
    write_hdf5(tmp_path / "hdf5" / "a.h5", *volume(0))
    (tmp_path / "hdf5" / "._a.h5").write_bytes(b"\0\5\x16\7")
    assert len(read_cases(tmp_path / "hdf5", "train")) == 1


def test_a_flipped_bit_is_found(tmp_path):
    path = write_nnunet(tmp_path) / "imagesTr" / "case1_0000.nii.gz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(FormatError, match="case1_0000"):
        read_cases(tmp_path, "train")


def test_bad_hdf5_files_are_named(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"no")
    with pytest.raises(FormatError, match=r"a\.h5 cannot be read"):
        read_cases(tmp_path, "train")
    write_hdf5(tmp_path / "a.h5", volume(0)[0])
    with pytest.raises(FormatError, match=r"a\.h5 has no data set called label"):
        read_cases(tmp_path, "train")


def test_hdf5_files_of_words_are_refused(tmp_path):
    image, label = volume(0)
    for attributes, words in (
        ({"spacing": "1 1 1"}, "has the spacing '1 1 1'"),
        ({"spacing": [1.0, 2.0]}, "2 numbers"),
        ({"spacing": [1.0, 1.0, 0.0]}, r"a\.h5 has the spacing \[1. 1. 0.\]: three positive lengths"),
        ({"spacing": [-1.0, 1.0, 1.0]}, "three positive lengths"),
        ({"spacing": [1.0, float("nan"), 1.0]}, "three positive lengths"),
    ):
        with pytest.raises(FormatError, match=words):
            read_cases(write_hdf5(tmp_path / "a.h5", image, label, **attributes).parent)
    with pytest.raises(FormatError, match=r"a\.h5 has an image of type object"):
        read_cases(write_hdf5(tmp_path / "a.h5", np.array([b"a", b"b"], dtype=object)).parent)
    with pytest.raises(FormatError, match=r"a\.h5 holds values of type object"):
        read_cases(write_hdf5(tmp_path / "a.h5", image, np.array([b"a", b"b"], dtype=object)).parent)


def test_folders_without_cases(tmp_path):
    with pytest.raises(FormatError, match="not a folder"):
        read_cases(tmp_path / "nothing", "train")
    with pytest.raises(FormatError, match="no cases"):
        read_cases(tmp_path, "train")


def test_the_left_atria(data_dir):
    if not (data_dir / "la").is_dir():
        pytest.skip("needs the left-atrium data")
    cases = read_cases(data_dir / "la", "val")
    assert len(cases) == 8
    assert all(c.label is not None and c.label.any() and c.label.shape == c.image.shape for c in cases)


@pytest.mark.parametrize("how", ["external storage", "external link", "through a link", "virtual"])
def test_an_hdf5_file_reads_no_other_file(how, tmp_path):
    h5py = pytest.importorskip("h5py")
    secret = np.arange(64, dtype=np.float32).reshape(4, 4, 4)
    (tmp_path / "secret.raw").write_bytes(secret.tobytes())
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["image"] = secret
    with h5py.File(tmp_path / "case.h5", "w") as file:
        if how == "external storage":
            stored = [(str(tmp_path / "secret.raw"), 0, h5py.h5f.UNLIMITED)]
            file.create_dataset("image", (4, 4, 4), "f4", external=stored)
        elif how == "virtual":
            layout = h5py.VirtualLayout((4, 4, 4), "f4")
            layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "image", (4, 4, 4))
            file.create_virtual_dataset("image", layout)
        else:
            file["far"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/")
            file["image"] = h5py.SoftLink("/far/image")
            if how == "external link":
                del file["image"]
                file["image"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "image")
    with pytest.raises(FormatError, match=r"case\.h5 has its image in another file"):
        read_hdf5(tmp_path / "case.h5")
