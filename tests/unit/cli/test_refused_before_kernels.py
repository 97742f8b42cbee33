"""Options that cannot be used are refused before any kernel is compiled, any mesh measured and any folder made."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
import trimesh
import warp

from sdm.cli import main
from sdm.kernels import launch


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """A folder with a mesh and a folder of meshes, where a launch of a kernel is a mistake."""

    def launched(*args, **kwargs):
        raise AssertionError("a kernel was launched")

    monkeypatch.setattr(launch, "run", launched)
    monkeypatch.setattr(warp, "launch", launched)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "there.zarr").mkdir()
    for number in range(3):
        ball = trimesh.creation.icosphere(1)
        ball.apply_scale([1 + 0.2 * number, 1, 1])
        ball.export(tmp_path / "meshes" / f"{number}.stl")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("generate cochlea -o d.zarr --count 2 --resolution 0", "resolution 0"),
        ("generate cochlea -o d.zarr --count 2 --margin -1", "margin -1.0"),
        ("generate cochlea -o d.zarr --count 2 --resolution 100000", "GiB free"),
        ("generate cochlea -o d.zarr --count 0", "0 samples"),
        ("generate cochlea -o d.zarr --count 2 --shard 0", "shard of 0"),
        ("generate cochlea -o d.zarr --count 2 --truncate -1", "truncation -1.0"),
        ("generate cochlea -o d.zarr --count 2 --sampler nothing", "no sampler called 'nothing'"),
        ("generate cochlea -o d.zarr --count 2 --hole-size 1", "hole_size"),
        ("generate cochlea -o d.zarr --count 2 --device tpu", "no device called 'tpu'"),
        ("generate cochlea -o there.zarr --count 2", "is there already"),
        ("generate cochlea -o nowhere/d.zarr --count 2", "nowhere is not there"),
        ("generate cochlea -o d.zarr --count 2 --skip-bad", "--skip-bad is for a folder"),
        ("generate meshes -o d.zarr --count 2 --resolution 0", "resolution 0"),
        ("compute meshes -o maps --resolution 0", "resolution 0"),
        ("compute meshes -o maps --margin -1", "margin -1.0"),
        ("compute meshes -o maps --spacing 1 0 1", "must be positive"),
        ("compute meshes/0.stl -o x.nrrd --dtype float16", "cannot hold float16"),
        ("sample meshes -o samples --count 0", "--count is 0"),
        ("sample meshes -o samples --device tpu", "no device called 'tpu'"),
        ("split meshes --val 2", "leave nothing for train"),
        ("split meshes --group (", "no regular expression"),
        ("split meshes --group none([0-9]+)", "every mesh needs a group"),
        ("split meshes --twins -1", "twins are -1"),
        ("watertight meshes -o closed --resolution 3", "too low for a surface"),
        ("watertight meshes/0.stl -o closed.stl --offset -1", "offset is -1.0"),
        ("watertight meshes/0.stl -o closed.stl --resume", "closed.stl is one file"),
        ("watertight meshes/0.stl -o closed.stl --hidden keep --hole-size 1", "--hidden keep"),
        ("encode meshes/0.stl -m cochlea -o c.npz --steps 0", "0 steps"),
        ("view meshes/0.stl --out x.bmp", "does not end in .png"),
        ("demo --resolution 1 --out demo", "give at least 2"),
        ("fit meshes/0.stl -o f.json --triangles 0 --family cochlea", "0 triangles"),
        ("fit x.nii.gz -o f.json --estimate-blur --model labels", "labels have no blur"),
        ("fit x.nii.gz -o f.json --estimate-formation --blur 0", "give one above 0"),
        ("fit --points meshes/0.stl -o f.json --estimate-blur", "of an image's fit"),
        ("fit --points meshes/0.stl -o f.json --blur 0", "--blur is of an image's fit: leave it out with --points"),
        (
            "fit --points meshes/0.stl -o f.json --fine 0.2 --model labels --mirror",
            "--mirror, --model and --fine are of",
        ),
        ("fit --points meshes/0.stl -o f.json --components 1 1", "--components is of an image's fit"),
        ("fit --points meshes/0.stl -o f.json --device tpu", "no device called 'tpu'"),
        ("fit x.nii.gz -o f.json --model labels --blur 0.3", "with labels a voxel is one point, and has no blur"),
        ("fit x.nii.gz -o f.json --weights w.pt", "--weights are a surrogate's"),
        ("train sdmnn --family cochlea --out run --budget-s 0", "trains nothing"),
        ("train sdmnn --family cochlea --out run --budget-s 5 --resolution 0", "resolution 0"),
        ("train sdmnn --out run --device tpu", "no device called 'tpu'"),
        ("train deepsdf meshes --out run --budget-s 5 --width 0", "width is 0"),
        ("shape-model build meshes -o m.npz --method sdm --resolution 0", "resolution 0"),
    ],
)
def test_one_sentence_and_nothing_left(place, capsys, words, said):
    before = sorted(place.rglob("*"))
    assert main(shlex.split(words)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert [path.name for path in sorted(place.rglob("*")) if path not in before] in ([], ["maps"], ["closed"])


def test_a_fit_takes_no_triangles_for_the_default(place, capsys):
    """Zero is a number, and no word for "as usual"."""
    import torch

    import sdm

    sdm.SDM(torch.rand(8, 8, 8), sdm.Grid((0, 0, 0), (1, 1, 1), (8, 8, 8))).save("scan.nii.gz")
    assert main(["fit", "scan.nii.gz", "-o", "f.json", "--triangles", "0"]) == 2
    assert "0 triangles" in capsys.readouterr().err
