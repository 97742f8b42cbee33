"""`sdm edt` and label volumes of `sdm compute`: a map for each class, on the image's grid."""

from __future__ import annotations

from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

import sdm
from sdm.cli import main

AFFINE = np.diag([-0.8, 0.8, 1.5, 1.0])
AFFINE[:3, 3] = 10, -5, 3


@pytest.fixture
def labels(tmp_path, monkeypatch):
    values = np.zeros((16, 14, 12), np.uint8)
    values[3:9, 3:11, 3:9] = 1
    values[9:13, 4:10, 3:9] = 7
    nib.save(nib.Nifti1Image(values, AFFINE), tmp_path / "labels.nii.gz")
    monkeypatch.chdir(tmp_path)
    return values


def test_a_map_for_each_class(labels, capsys):
    assert main(["edt", "labels.nii.gz", "-o", "maps.nii.gz", "--device", "cpu"]) == 0
    assert "class 7, 144 voxels" in capsys.readouterr().out
    for value in (1, 7):
        field = sdm.load(f"maps_{value}.nii.gz")
        np.testing.assert_allclose(field.grid.affine, AFFINE, atol=1e-6)
        wanted = sdm.euclidean_distance_transform(labels == value, (0.8, 0.8, 1.5), signed=True, surface="faces")
        np.testing.assert_allclose(field.values, wanted, rtol=1e-6)


def test_a_class_alone(labels):
    assert main(["edt", "labels.nii.gz", "-o", "one.npz", "--classes", "7", "--unsigned", "--surface", "centres"]) == 0
    field = sdm.load("one.npz")
    np.testing.assert_allclose(field.values, sdm.euclidean_distance_transform(labels == 7, (0.8, 0.8, 1.5)), rtol=1e-6)
    assert field.sign == "none"


def test_smooth_surfaces(labels):
    assert main(["edt", "labels.nii.gz", "-o", "s.npz", "--classes", "1", "7", "--smooth", "0.8"]) == 0
    for value in (1, 7):
        field = sdm.load(f"s_{value}.npz")
        volume = np.prod(field.grid.spacing) * (labels == value).sum()
        assert abs(field.to_mesh().to_trimesh().volume / volume - 1) < 0.05
        by_voxels = sdm.euclidean_distance_transform(labels == value, field.grid.spacing, signed=True, surface="faces")
        # It is in the same place, and has no steps.
        far = by_voxels > 3
        assert np.abs(field.numpy() - by_voxels)[far].max() < 1.0
        assert ((field.numpy() < 0) == (labels == value)).mean() > 0.97


def test_compute_takes_labels(labels):
    assert main(["compute", "labels.nii.gz", "-o", "c.nii.gz", "--device", "cpu"]) == 0
    assert main(["edt", "labels.nii.gz", "-o", "e.nii.gz", "--device", "cpu"]) == 0
    assert sdm.load("c_7.nii.gz").values.equal(sdm.load("e_7.nii.gz").values)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("edt labels.nii.gz -o m.npz --classes 3", "has no class 3: there are 1, 7"),
        ("edt labels.nii.gz -o m.txt", "does not end like a map"),
        ("edt none.nii.gz -o m.npz", "there is no file none.nii.gz"),
        ("edt labels.nii.gz -o m.npz --smooth 1 --unsigned", "leave out --unsigned"),
        ("compute labels.nii.gz -o m.npz --resolution 8", "on its own grid: leave out --resolution"),
    ],
)
def test_what_is_refused(labels, words, message, capsys):
    assert main(words.split()) == 2
    assert message in capsys.readouterr().err


def test_other_images_are_no_labels(labels, capsys):
    nib.save(nib.Nifti1Image(np.full((4, 4, 4), 0.5), np.eye(4)), "ct.nii")
    nib.save(nib.Nifti1Image(np.zeros((4, 4, 4), np.uint8), np.eye(4)), "empty.nii")
    assert main(["edt", "ct.nii", "-o", "m.npz"]) == 2
    assert "no label volume" in capsys.readouterr().err
    assert main(["edt", "empty.nii", "-o", "m.npz"]) == 2
    assert "nothing but 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--sign", "flood", "--hole-size", "1"], "--sign flood"),
        (["--orient", "parts"], "--orient"),
        (["--scale", "1000"], "--scale"),
        (["--truncate", "3"], "--truncate"),
        (["--band", "3"], "--band"),
    ],
)
def test_compute_refuses_what_only_meshes_take(labels, words, named, capsys):
    assert main(["compute", "labels.nii.gz", "-o", "maps.nii.gz", "--device", "cpu", *words]) == 2
    assert f"{named} is for meshes" in capsys.readouterr().err
    assert not list(Path().glob("maps*"))
