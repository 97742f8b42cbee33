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


def _tree(folder: str, values: np.ndarray, *names: str) -> None:
    for name in names:
        (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
        sdm.save(sdm.SDM(values.astype(np.float32), sdm.Grid.from_affine(AFFINE, values.shape)), f"{folder}/{name}")


def _written(folder: str) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in Path(folder).rglob("*.n*"))


def test_a_folder_lies_as_it_lay_and_a_bad_volume_stops_no_other(labels, capsys):
    _tree("in", labels, "a.nii.gz", "sub/deep/b.nrrd")
    _tree("in", 0.5 * labels, "ct.nii.gz")
    Path("in/.hidden.nii.gz").write_bytes(b"")
    Path("in/broken.nii.gz").write_bytes(b"no image")
    Path("in/notes.txt").write_text("no volume")
    assert main(["edt", "in", "-o", "out", "--device", "cpu"]) == 2
    said = capsys.readouterr()
    assert _written("out") == ["a_1.nii.gz", "a_7.nii.gz", "sub/deep/b_1.nii.gz", "sub/deep/b_7.nii.gz"]
    assert main(["edt", "labels.nii.gz", "-o", "one.nii.gz", "--device", "cpu"]) == 0
    assert sdm.load("out/a_7.nii.gz").values.equal(sdm.load("one_7.nii.gz").values)
    lines = said.err.splitlines()
    assert len(lines) == 3
    assert "in/broken.nii.gz" in lines[0]
    assert "in/ct.nii.gz holds other values than whole numbers" in lines[1]
    assert lines[2] == "sdm: 2 of 4 label volumes failed; the others are done"


def test_no_two_maps_of_a_folder_have_one_name(labels):
    """Also where a volume is called as another one's map would be."""
    one = np.where(labels == 1, 1, 0)
    _tree("in", labels, "a.nii.gz", "a.nrrd", "b.nii.gz")
    _tree("in", one, "b_1.nii.gz")
    _tree("other", one, "c.nii.gz")
    assert main(["edt", "in", "other/c.nii.gz", "-o", "out", "--format", "npz", "--device", "cpu"]) == 0
    assert _written("out") == [
        "a.nii.gz_1.npz",
        "a.nii.gz_7.npz",
        "a.nrrd_1.npz",
        "a.nrrd_7.npz",
        "b_1.npz",
        "b_1_1.npz",
        "b_7.npz",
        "c_1.npz",
    ]


def test_files_of_one_name_from_two_folders(labels):
    for folder in ("x", "y"):
        _tree(folder, labels, "a.nii.gz")
    words = ["edt", "x/a.nii.gz", "y/a.nii.gz", "./x/a.nii.gz", "-o", "out", "--classes", "7", "--device", "cpu"]
    assert main(words) == 0
    assert _written("out") == ["x/a_7.nii.gz", "y/a_7.nii.gz"]


def test_zarr_volumes_are_files_of_a_folder(labels):
    _tree("in", labels, "a.zarr")
    for words in (["in", "-o", "out"], ["in/a.zarr", "-o", "one"]):
        assert main(["edt", *words, "--device", "cpu"]) == 0
        assert _written(words[-1]) == ["a_1.nii.gz", "a_7.nii.gz"]


def test_maps_of_a_run_before_are_no_labels(labels, capsys):
    _tree("in", labels, "a.nii.gz")
    for _ in range(2):
        assert main(["edt", "in", "-o", "in/maps", "--device", "cpu"]) == 0
        assert _written("in") == ["a.nii.gz", "maps/a_1.nii.gz", "maps/a_7.nii.gz"]
    capsys.readouterr()
    assert main(["edt", "in", "-o", "in"]) == 2
    assert "in is the folder of the label volumes: name another one" in capsys.readouterr().err


def test_a_volume_is_not_written_over(labels, capsys):
    """The map of one would be the file of another; that one fails, and the others are done."""
    _tree("all/in", labels, "a.nii.gz")
    _tree("all", labels, "a_7.nii.gz")
    before = Path("all/a_7.nii.gz").read_bytes()
    assert main(["edt", "all/in", "all/a_7.nii.gz", "-o", "all", "--device", "cpu"]) == 2
    assert "all/a_7.nii.gz is an input too" in capsys.readouterr().err
    assert Path("all/a_7.nii.gz").read_bytes() == before
    assert Path("all/a_7_7.nii.gz").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("edt in labels.nii.gz -o m.npz", "several label volumes need a folder to write to"),
        ("edt empty -o out", "no volume was found in empty"),
        ("edt in -o labels.nii.gz/out", "cannot be made"),
    ],
)
def test_what_is_refused_of_folders(labels, words, message, capsys):
    _tree("in", labels, "a.nii.gz")
    Path("empty").mkdir()
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_a_folder_at_an_address(labels):
    memory = pytest.importorskip("fsspec", reason="needs fsspec, of the extra remote").filesystem("memory")
    memory.store.clear()
    for name in ("a.nii.gz", "sub/b.nii.gz"):
        memory.pipe(f"/labels/{name}", Path("labels.nii.gz").read_bytes())
    words = ["memory://labels", "-o", "memory://maps", "--classes", "7", "--device", "cpu"]
    assert main(["edt", *words]) == 0
    assert sorted(memory.find("/maps")) == ["/maps/a_7.nii.gz", "/maps/sub/b_7.nii.gz"]
    Path("b.nii.gz").write_bytes(memory.cat("/maps/sub/b_7.nii.gz"))
    memory.store.clear()
    assert main(["edt", "labels.nii.gz", "-o", "one.nii.gz", "--classes", "7", "--device", "cpu"]) == 0
    assert sdm.load("b.nii.gz").values.equal(sdm.load("one.nii.gz").values)
