"""Hostile and clumsy command lines: each ends in one sentence and exit code 2, and leaves every file as it was.

A table of one case a line; `test_bad_input.py` has those of `sdm compute` that any user meets.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import nibabel
import numpy as np
import pytest
import torch
import trimesh

from sdm.cli import main

COCHLEA = "predict --a 3 --alpha 0.5 --b 0.1 --phi 0 -o new.npz"
EMPTY, LONG, ODD = "<empty>", "<long>", "<odd>"
SPECIAL = {EMPTY: "", LONG: f"{'x' * 300}", ODD: os.fsdecode(b"b\xff.ply")}

CASES = [
    # Names.
    ("compute <empty> -o new.npz", "an argument is empty"),
    ("compute ball.ply -o <empty>", "an argument is empty"),
    ("inspect <empty>", "an argument is empty"),
    ("compute loop.ply -o new.npz", "loop.ply cannot be read: "),
    ("compute folder.ply -o new.npz", "no mesh file was found"),
    ("compute empty.ply -o new.npz", "empty.ply is empty"),
    ("compute empty.stl -o new.npz", "empty.stl is empty"),
    ("compute pipe.ply -o new.npz", "pipe.ply is empty"),
    ("compute <odd> -o new.npz", "is not UTF-8"),
    ("compute <long>.ply -o new.npz", "File name too long"),
    ("compute ball.ply -o <long>.npz", "File name too long"),
    ("compute ball.ply -o <long>/new.npz", "File name too long"),
    ("compute ball.ply -o .npz", "does not end like a map"),
    ("compute ball.ply -o /dev/null", "/dev/null is a file, and its name does not end like a map"),
    ("compute ball.ply -o /dev/null/new.npz", "/dev/null is not a folder"),
    ("compute ball.ply -o ball.ply", "does not end like a map"),
    ("compute ball.ply -o map.npz --grid-like map.npz", "is an input too"),
    ("inspect folder.ply", "folder.ply is a folder"),
    ("inspect loop.ply", "loop.ply cannot be read: "),
    ("inspect map.npz", "ends like an image or a map"),
    ("inspect file", "file is no mesh by a name without an ending; known are .stl"),
    ("compute ball.ply -o new.npz --report new.npz", "new.npz is given for two outputs"),
    ("compute ball.ply -o loop.ply --report loop.ply", "does not end like a map"),
    ("watertight ball.ply -o new.ply --report loop/x.json", "is not there; make it first"),
    ("watertight ball.ply -o new.ply --report loop.json --resolution 0", "resolution"),
    ("watertight ball.ply -o new.ply --report new.ply", "new.ply is given for two outputs"),
    (
        "compute ball.ply -o new --format tif",
        "--format takes one of mha, mhd, nii, nii.gz, npz, nrrd,",
    ),
    ("sample ball.ply -o file", "file is a file: name a folder for the samples"),
    # Numbers.
    ("compute ball.ply -o new.npz --resolution 1e9", "takes a whole number"),
    ("compute ball.ply -o new.npz --resolution 1.5", "takes a whole number"),
    ("compute ball.ply -o new.npz --resolution nan", "takes a whole number"),
    ("compute ball.ply -o new.npz --resolution 2 2 2 2", "one number or three, not 4"),
    ("compute ball.ply -o new.npz --resolution 1000000000", "1e+09 voxels along an axis; at most 16,777,216"),
    ("compute ball.ply -o new.npz --resolution 1000000000 1 1", "1e+09 voxels along an axis; at most 16,777,216"),
    ("compute ball.ply -o new.zarr --resolution 1 1 3000000000", "3e+09 voxels along an axis"),
    ("compute ball.ply -o new.npz --spacing inf", "must be positive"),
    ("compute ball.ply -o new.npz --spacing 1e-300", "gives 2.2e+300 voxels along an axis"),
    ("compute ball.ply -o new.npz --spacing 1e300", "is more than the whole of ball.ply, 2 along its longest edge"),
    ("compute ball.ply -o new.npz --spacing 3", "is more than the whole of ball.ply"),
    ("compute ball.ply -o new.npz --margin nan", "margin nan"),
    ("compute ball.ply -o new.npz --margin 1e300 --resolution 8", "the grid reaches too far"),
    ("compute ball.ply -o new.npz --margin 1e32 --resolution 8", "the grid reaches too far"),
    ("compute ball.ply -o new.npz --margin 0.1 --grid-like label.nii.gz", "--grid-like says where the grid is"),
    ("compute one.nii.gz -o new.npz --margin 0.1", "--margin is for meshes"),
    ("compute one.nii.gz -o new.npz --format nii", "--format is for meshes"),
    ("compute one.nii.gz -o new.npz --skip-bad", "--skip-bad is for meshes"),
    ("compute ball.ply -o new.npz --scale 0", "--scale is 0"),
    ("compute ball.ply -o new.npz --scale nan", "--scale is nan"),
    ("compute ball.ply -o new.npz --scale 1e300", "every coordinate must be finite"),
    ("compute ball.ply -o new.npz --scale 1e-300", "has size zero"),
    ("compute ball.ply -o new.npz --hole-size 1", "with sign='winding' it says nothing"),
    ("compute ball.ply -o new.npz --sign flood --hole-size nan", "hole_size is nan"),
    ("sample ball.ply -o new --count 1000000000000", "1,000,000,000,000 samples need"),
    ("sample ball.ply -o new --deviations nan", "nan is no law"),
    ("edt one.nii.gz -o new.npz --smooth nan", "a smoothing of nan mm is not positive"),
    ("edt one.nii.gz -o new.npz --smooth 1 --surface centres", "leave out --surface"),
    ("edt one.nii.gz -o new.npz --smooth 60", "a smoothing of 60 mm leaves nothing of a label that is 3 mm long"),
    ("edt full.nii.gz -o new.npz", "every voxel of full.nii.gz is of class 1"),
    ("edt full.nii.gz -o new.npz --classes 0", "full.nii.gz has no class 0: there are 1"),
    ("split folder.ply --val 0.9 --test 0.9", "no mesh file was found in folder.ply"),
    ("split good -o new.json --val 0.9 --test 0.9", "shares of 0.9 for val and 0.9 for test leave nothing for train"),
    ("compute nan.off -o new.npz", "vertex 4 of nan.off is [nan, nan, nan]"),
    ("compute float64.off -o new.npz", "every coordinate must be finite"),
    ("compute largest.off -o new.npz", "at most 1e+30 is supported"),
    ("compute ball.ply -o new.npz --device cuda:-1", "no device called 'cuda:-1'"),
    ("compute ball.ply -o new.npz --device meta", "meta is not supported"),
    ("compute ball.ply -o new.npz --grid-like nan_origin.nii", "must be a finite 4 x 4 matrix"),
    ("compute ball.ply -o new.npz --grid-like flat.nii", "its voxels have no volume"),
    ("compute ball.ply -o new.npz --grid-like four.nii", "three dimensions"),
    ("compute ball.ply -o new.npz --grid-like cut.nii.gz", "is damaged"),
    ("compute ball.ply -o new.npz --grid-like empty.nii.gz", "is not a NIfTI image"),
    # Datasets.
    ("generate cuboid -o new.zarr", "say how many samples"),
    ("generate cuboid -o new.zarr --count -1", "give at least 1"),
    ("generate cuboid -o new.zarr --count 1000000000000000 --resolution 999", "at most 10,000,000 are supported"),
    ("generate cuboid -o new.zarr --count 2 --sampler grid:0", "has no width"),
    ("generate cuboid -o new.zarr --count 2 --truncate nan", "must be a positive distance"),
    ("generate cuboid -o file --count 2", "file is there already"),
    ("generate cubiod -o new.zarr --count 2", "neither a family"),
    ("generate folder.ply -o new.zarr --count 2", "no mesh to use"),
    ("generate -o file --verify --count 3", "--verify makes shards again as the dataset was begun: leave out --count"),
    ("generate -o file --verify --hole-size 3", "leave out --hole-size"),
    ("generate -o file --verify --resume", "leave out --resume"),
    ("generate -o file --verify", "is not a dataset"),
    ("generate -o new.zarr --resume", "is not a dataset"),
    # Networks.
    (f"{COCHLEA} --weights empty.pt", "empty.pt is not a surrogate that sdm wrote"),
    (f"{COCHLEA} --weights cut.safetensors", "cut.safetensors is not a surrogate"),
    (f"{COCHLEA} --weights cut.json", "cut.json is not a surrogate"),
    (f"{COCHLEA} --weights nowhere.safetensors", "nowhere.safetensors cannot be read: no such file"),
    (f"{COCHLEA} --weights empty.pt --exact", "leave out --weights"),
    (f"{COCHLEA} --exact --a inf", "give four finite numbers"),
    (f"{COCHLEA} --a nan", "a of theta is nan"),
    ("encode ball.ply -m list.pt -o new.npz", "is no DeepSDF model"),
    ("encode ball.ply -m nowhere -o new.npz", "train a model first"),
    ("encode ball.ply -m cochlea -o new.npz --sphere 0 0 0 0", "a positive radius"),
    ("encode sheet.off -m cochlea -o new.npz", "is not closed"),
    ("decode empty.npz -m cochlea -o new.ply", "empty.npz is no code of a shape"),
    ("decode cut.npz -m cochlea -o new.ply", "cut.npz is no code of a shape"),
    ("decode map.npz -m cochlea -o map.npz", "is an input too"),
    ("segment label.nii.gz --model list.pt -o new", "list.pt is not a trained segmentation network"),
    ("segment label.nii.gz --model nowhere.pt -o new", "nowhere.pt is not there"),
    ("train deepsdf folder.ply -o new --epochs 1", "there are no meshes"),
    ("train deepsdf cuboid -o new --epochs 0", "epochs is 0"),
    ("train deepsdf cuboid -o new --epochs 1 --batch-size 0", "batch size is 0; it must be 1 or more"),
    ("train sdmnn -o new --learning-rate -1", "learning rate is -1.0; it must be 0 or more"),
    ("fit --points folder.ply -o new.json", "folder.ply is a folder; give a file of points"),
    ("train sdmnn -o new --budget-s nan", "a budget of nan seconds"),
    ("train sdmnn -o new --start nowhere.safetensors", "no such file"),
    ("train sdmnn -o new --start cut.safetensors", "is not a surrogate that sdm wrote"),
    ("train sdmnn -o new --open-meshes keep", "there is no option --open-meshes; see sdm train --help"),
    ("compute ball.ply -o m.npz --report", "--report needs a value; see sdm compute --help"),
    ("inspect ball.ply other.ply", "one argument too many: other.ply; see sdm inspect --help"),
    ("inspect ball.ply --jsn", "there is no option --jsn; perhaps --json is meant; see sdm inspect --help"),
    ("train segmentation --data folder.ply -o new", "holds no cases to train"),
    # Images.
    ("fit empty.nii.gz -o new.json", "is not a NIfTI image"),
    ("fit four.nii -o new.json", "three dimensions"),
    ("fit label.nii.gz -o label.nii.gz", "is an input too"),
    ("fit label.nii.gz -o new.json --blur nan", "blur is nan"),
    ("fit label.nii.gz -o new.json --triangles 1000000000", "500 to 4,000,000 are supported"),
    ("evaluate label.nii.gz other.nii.gz", "has the shape"),
    ("evaluate label.nii.gz label.nii.gz --json label.nii.gz", "is an input too"),
    ("evaluate folder.ply label.nii.gz", "no labels to evaluate"),
    ("evaluate label.nii.gz nowhere.nii.gz", "there is no file or folder nowhere.nii.gz"),
    ("view map.npz --out new.txt", "does not end in .png"),
    ("view map.npz --resolution 8 --out new.png", "leave out --resolution"),
    ("view ball.ply --resolution 0 --out new.png", "resolution 0"),
    ("view cut.npz --out new.png", "cut.npz cannot be read"),
    # The repository's own.
    ("demo --resolution 100000 --out new", "GiB free"),
    ("demo --out file", "the folder file cannot be made"),
    ("bench --meshes torus-0 --quick --peers sdm", "there is no mesh called 'torus-0'"),
    ("bench --meshes ball.ply --quick --peers sdm --out file", "the folder file cannot be made"),
    ("bench --add file --quick", "file does not run as a Python file: NameError"),
    ("bench --runs 0 --quick", "runs must be at least 1"),
    ("bench zoo folder.ply", "there is no mesh file in folder.ply"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder of good files, and of bad ones of every kind."""
    place = tmp_path_factory.mktemp("hostile")
    before = Path.cwd()
    os.chdir(place)
    yield _filled(place)
    os.chdir(before)


def _filled(place: Path) -> Path:
    trimesh.creation.icosphere(1).export("ball.ply")
    Path("loop.ply").symlink_to("loop.ply")
    Path("loop.json").symlink_to("loop.json")
    Path("folder.ply").mkdir()
    Path("pipe.ply").symlink_to("/dev/null")
    Path("file").write_text("nothing\n")
    shutil.copy("ball.ply", SPECIAL[ODD])
    for name in ("empty.ply", "empty.stl", "empty.npz", "empty.nii.gz", "empty.pt"):
        Path(name).touch()
    tetrahedron = "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
    for name, far, more in (("nan", "1", "nan nan nan\n"), ("float64", "1e39", ""), ("largest", "2e30", "")):
        corners = f"0 0 0\n{far} 0 0\n0 {far} 0\n0 0 {far}\n{more}"
        Path(f"{name}.off").write_text(f"OFF\n{len(corners.splitlines())} 4 0\n{corners}{tetrahedron}")
    Path("sheet.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    zeros = np.zeros((8, 8, 8), np.uint8)
    for name, values in (("label.nii.gz", zeros), ("other.nii.gz", zeros[:7]), ("four.nii", zeros[..., None, None])):
        nibabel.save(nibabel.Nifti1Image(np.repeat(values, 2, -1), np.eye(4)), name)
    few = np.zeros_like(zeros)
    few[3:6, 3:5, 3:5] = 1
    for name, values in (("one.nii.gz", few), ("full.nii.gz", np.ones_like(zeros))):
        nibabel.save(nibabel.Nifti1Image(values, np.eye(4)), name)
    Path("good").mkdir()
    shutil.copy("ball.ply", "good/ball.ply")
    # By its bytes: nibabel writes no such header. The first row of the affine begins at 280.
    for name, at, number in (("nan_origin.nii", 292, np.nan), ("flat.nii", 280, 0.0)):
        nibabel.save(nibabel.Nifti1Image(zeros, np.eye(4)), name)
        image = bytearray(Path(name).read_bytes())
        image[at : at + 4] = np.float32(number).tobytes()
        Path(name).write_bytes(image)
    assert main(["compute", "ball.ply", "-o", "map.npz", "--resolution", "4", "--device", "cpu"]) == 0
    for name in ("map.npz", "label.nii.gz"):
        whole = Path(name).read_bytes()
        Path(name.replace("map", "cut").replace("label", "cut")).write_bytes(whole[: len(whole) // 2])
    torch.save([1, 2], "list.pt")
    Path("cut.safetensors").write_bytes(b"x" * 100)
    Path("cut.json").write_text("{}")
    return place


def _state(place: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.lstat().st_size, path.lstat().st_mtime_ns) for path in place.rglob("*")}


@pytest.mark.parametrize(("words", "expected"), CASES, ids=[words for words, _ in CASES])
def test_one_sentence_and_nothing_touched(words, expected, folder, capsys):
    for mark, text in SPECIAL.items():
        words = words.replace(mark, text or "\0")
    before = _state(folder)
    assert main(["" if word == "\0" else word for word in words.split(" ")]) == 2
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert line.startswith("sdm: ")
    assert expected in line
    assert said.out == ""
    assert _state(folder) == before
