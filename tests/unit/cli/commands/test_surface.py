"""`sdm surface`: meshes of maps, of narrow bands and of the classes of label volumes, and what is refused."""

from __future__ import annotations

from pathlib import Path

import nibabel as nib
import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli import main

# Left-handed, and turned about z.
AFFINE = np.array([[0.0, -0.8, 0, 10], [-0.9, 0, 0, -5], [0, 0, -1.5, 3], [0, 0, 0, 1]])


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """A folder with the map and the narrow band of a ball, and a label volume."""
    monkeypatch.chdir(tmp_path)
    ball = trimesh.creation.icosphere(3, 1.0)
    ball.apply_translation([5, -3, 2])
    grid = sdm.Grid((3, -5, 0), (0.125,) * 3, (33, 33, 33))
    Path("maps/deep").mkdir(parents=True)
    sdm.signed_distance_map(ball, grid, device="cpu").save("maps/ball.nii.gz")
    sdm.narrow_band(ball, grid, half_width=3, device="cpu").save("maps/deep/band.npz")
    values = np.zeros((16, 14, 12), np.uint8)
    values[3:9, 3:11, 3:9] = 1
    values[9:13, 4:10, 3:9] = 7
    nib.save(nib.Nifti1Image(values, AFFINE), "labels.nii.gz")
    return tmp_path


def run(words: str) -> int:
    return main(["surface", *words.split(), "--device", "cpu"])


def solid(path: str) -> trimesh.Trimesh:
    found = sdm.load_mesh(path).to_trimesh()
    assert found.is_watertight
    return found


@pytest.mark.parametrize("ending", ["nii.gz", "npz", "nrrd", "mha", "vti", "zarr"])
def test_the_mesh_of_a_map(place, ending, capsys):
    field = sdm.load("maps/ball.nii.gz")
    field.save(f"ball.{ending}")
    assert run(f"ball.{ending} -o ball.ply") == 0
    said = capsys.readouterr()
    assert "triangles" in said.out
    assert "written to ball.ply" in said.out
    assert said.err == ""
    expected, found = field.to_mesh(), sdm.load_mesh("ball.ply")
    assert torch.equal(found.vertices, expected.vertices)
    assert torch.equal(found.faces, expected.faces)


def test_another_level_and_the_other_space(place):
    assert run("maps/ball.nii.gz -o out.stl --level 0.3 --mesh-space lps") == 0
    found = solid("out.stl")
    # Of a ball of radius 1.3, which still faces outward.
    assert found.volume == pytest.approx(4 / 3 * np.pi * 1.3**3, rel=0.02)
    np.testing.assert_allclose(found.bounds.mean(0), [-5, 3, 2], atol=0.01)


def test_a_folder_of_maps(place, capsys):
    (place / "maps" / "broken.npz").write_bytes(b"PK nothing")
    (place / "maps" / "notes.txt").write_text("no map")
    assert run("maps -o meshes --format obj") == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert "maps/broken.npz cannot be read" in said[0]
    assert said[1] == "sdm: 1 of 3 maps failed; the others are done"
    assert sorted(str(path.relative_to("meshes")) for path in Path("meshes").rglob("*.*")) == [
        "ball.obj",
        "deep/band.obj",
    ]
    # A band has the surface of the whole map.
    assert Path("meshes/ball.obj").read_bytes() == Path("meshes/deep/band.obj").read_bytes()


def test_a_mesh_of_each_class(place, capsys):
    assert run("labels.nii.gz -o organs.stl") == 0
    assert "labels.nii.gz, class 7: " in capsys.readouterr().out
    assert sorted(path.name for path in Path().glob("organs*")) == ["organs_1.stl", "organs_7.stl"]
    labels = sdm.load("labels.nii.gz").values
    for value in (1, 7):
        again = sdm.signed_distance_map(solid(f"organs_{value}.stl"), "labels.nii.gz", device="cpu")
        assert torch.equal(again.values < 0, labels == value)


def test_one_class(place):
    assert run("labels.nii.gz -o one.ply --label 7") == 0
    assert run("labels.nii.gz -o all --label 7") == 0
    assert [path.name for path in Path("all").iterdir()] == ["labels_7.ply"]
    assert Path("one.ply").read_bytes() == Path("all/labels_7.ply").read_bytes()
    assert run("labels.nii.gz -o smooth.ply --label 7 --smooth 0.8") == 0
    assert solid("smooth.ply").volume == pytest.approx(144 * 0.8 * 0.9 * 1.5, rel=0.05)
    assert run("labels.nii.gz -o larger.ply --label 7 --level 0.5") == 0
    assert solid("larger.ply").volume > 1.2 * solid("one.ply").volume


@pytest.mark.parametrize(("level", "smooth"), [(0.0, None), (1.7, None), (-0.3, None), (0.0, 0.9), (1.1, 0.7)])
def test_a_class_is_measured_as_in_the_whole_volume(tmp_path, monkeypatch, level, smooth):
    """Only what is around it is measured."""
    monkeypatch.chdir(tmp_path)
    values = np.zeros((40, 30, 50), np.uint8)
    values[6:9, 5:25, 20:30] = values[6:20, 5:9, 20:24] = 3
    values[30, 20, 45] = 3 if smooth is None else 0
    values[25:35, 4:9, 3:9] = 2
    nib.save(nib.Nifti1Image(values, AFFINE), "two.nii")
    more = [] if smooth is None else ["--smooth", str(smooth)]
    assert run(f"two.nii -o part.ply --label 3 --level {level} {' '.join(more)}") == 0
    assert main(["edt", "two.nii", "-o", "map.npz", "--classes", "3", "--device", "cpu", *more]) == 0
    found, expected = solid("part.ply"), sdm.load("map.npz").to_mesh(level).to_trimesh()
    assert len(found.faces) == len(expected.faces)
    assert found.volume == pytest.approx(expected.volume, rel=1e-5)
    assert found.area == pytest.approx(expected.area, rel=1e-5)
    np.testing.assert_allclose(found.bounds, expected.bounds, atol=1e-4)


def test_an_image_at_a_level(place):
    """Whole numbers are an image's where a level is given: of less than it, as maps have it, is inside."""
    values = np.full((9, 9, 9), 200, np.uint8)
    values[3:6, 3:6, 3:6] = 10
    nib.save(nib.Nifti1Image(values, np.eye(4)), "scan.nii")
    assert run("scan.nii -o scan.ply --level 105") == 0
    assert solid("scan.ply").bounds.tolist() == [[2.5] * 3, [5.5] * 3]


def test_an_open_surface_is_told_of(place, capsys):
    values = np.zeros((8, 8, 8), np.uint8)
    values[0:4, 2:6, 2:6] = 1
    nib.save(nib.Nifti1Image(values, np.eye(4)), "cut.nii")
    assert run("cut.nii -o cut.ply") == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("sdm: cut.nii, class 1: the surface reaches the grid's border")
    assert not sdm.load_mesh("cut.ply").to_trimesh().is_watertight


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("maps/ball.nii.gz -o x.ply --level 50", "maps/ball.nii.gz: the map runs from"),
        ("maps/ball.nii.gz -o x.ply --level 50", "no surface at level 50"),
        ("maps/ball.nii.gz -o x.ply --level nan", "level"),
        ("maps/ball.nii.gz -o x.ply --label 1", "and no label volume: --label is for label volumes"),
        ("maps/deep/band.npz -o x.ply --smooth 1", "and no label volume: --smooth is for label volumes"),
        ("maps/deep/band.npz -o x.ply --level 2", "maps/deep/band.npz: the band reaches"),
        ("maps/ball.nii.gz -o x.txt", "x.txt does not end like a mesh that can be written"),
        ("maps/ball.nii.gz -o x.ply --format obj", "does not end with .obj, which --format asks for"),
        ("maps/ball.nii.gz -o nowhere/x.ply", "the folder nowhere is not there"),
        ("maps/ball.nii.gz labels.nii.gz -o x.ply", "several maps need a folder"),
        ("maps -o x.ply", "several maps need a folder"),
        ("nowhere.npz -o x.ply", "there is no file nowhere.npz"),
        ("nowhere.npz -o x", "there is no file nowhere.npz"),
        ("empty -o x", "no map was found in empty"),
        ("ball.ply -o x.ply", "does not end like a map"),
        ("labels.nii.gz -o x.ply --label 3", "labels.nii.gz has no class 3: there are 1, 7"),
        ("full.nii -o x.ply", "every voxel of full.nii is of class 1"),
        ("zero.nii -o x.ply", "holds nothing but 0"),
        ("nan.nii -o x.ply", "16 of 64 values of nan.nii are not numbers (NaN)"),
        ("labels.nii.gz -o x.ply --device tpu", "no device called 'tpu'"),
    ],
)
def test_what_is_refused(place, words, message, capsys):
    Path("empty").mkdir()
    Path("ball.ply").touch()
    odd = np.ones((4, 4, 4))
    odd[1], odd[2] = -0.5, np.nan
    for name, values in {"full": np.ones((4, 4, 4)), "zero": np.zeros((4, 4, 4)), "nan": odd}.items():
        nib.save(nib.Nifti1Image(values.astype(np.float32), np.eye(4)), f"{name}.nii")
    before = sorted(place.rglob("*"))
    assert main(["surface", *words.split()]) == 2
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert message in line
    assert said.out == ""
    assert sorted(place.rglob("*")) == before


def test_two_meshes_of_one_name(place, capsys):
    """Class 1 of one volume, and a volume that is called like it."""
    Path("both").mkdir()
    for name in ("labels.nii.gz", "labels_1.nii.gz"):
        Path("both", name).write_bytes(Path("labels.nii.gz").read_bytes())
    sdm.load("maps/ball.nii.gz").save("both/labels_1.nii.gz")
    assert run("both -o out") == 2
    assert "out/labels_1.ply is given for two outputs" in capsys.readouterr().err
    assert len(list(Path("out").iterdir())) == 2
