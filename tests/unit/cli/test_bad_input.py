from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from sdm.cli import main
from sdm.core.grid import Grid
from sdm.io import save

OUT = "-o"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a good mesh and what users do wrong around it."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(1).export("ball.stl")
    (tmp_path / "nan.off").write_text("OFF\n3 1 0\n0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n")
    (tmp_path / "range.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n"
    )
    (tmp_path / "points.xyz").write_text("0 0 0\n1 1 1\n")
    (tmp_path / "damaged.glb").write_bytes(b"glTF????")
    (tmp_path / "mesh.foo").write_text("x")
    (tmp_path / "point.off").write_text("OFF\n1 1 0\n5 5 5\n3 0 0 0\n")
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder.nii.gz").mkdir()
    (tmp_path / "damaged.nii").write_bytes(b"junk")
    (tmp_path / "one").mkdir()
    trimesh.creation.box().export("one/ball.stl")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("missing.stl -o x.npz", "there is no mesh file missing.stl"),
        ("mesh.foo -o x.npz", "known are .stl"),
        ("damaged.glb -o x.npz", "damaged.glb cannot be read"),
        ("points.xyz -o x.npz", "points.xyz has no triangles"),
        ("nan.off -o x.npz", "every coordinate must be finite"),
        ("range.ply -o x.npz", "uses vertex 9"),
        ("point.off -o x.npz", "has size zero"),
        ("-o x.npz", "no mesh was given"),
        ("empty -o maps", "no mesh file was found in empty"),
        ("ball.stl -o x.tif", "does not end like a map"),
        ("ball.stl -o x.npz --format nrrd", "does not end with .nrrd"),
        ("ball.stl ball.stl -o x.npz", "several meshes need a folder"),
        ("ball.stl -o nowhere/x.npz", "nowhere is not there"),
        ("ball.stl -o file/x.npz", "is not a folder"),
        ("ball.stl ball.stl -o file", "file is a file, and its name does not end like a map: name a folder"),
        ("ball.stl -o folder.nii.gz/x/y.npz", "is not there"),
        ("ball.stl -o x.npz --resolution 0", "resolution 0"),
        ("ball.stl -o x.npz --resolution -5", "resolution -5"),
        ("ball.stl -o x.npz --spacing 0", "must be positive"),
        ("ball.stl -o x.npz --spacing -1", "must be positive"),
        ("ball.stl -o x.npz --spacing nan", "must be positive"),
        ("ball.stl -o x.npz --spacing 1 2", "one length or three, not 2"),
        ("ball.stl -o x.npz --resolution 4 4", "one number or three, not 2"),
        ("ball.stl -o x.npz --resolution 4,0,4", "or three, one for each axis"),
        ("ball.stl -o x.npz --spacing 1e-12", "choose a larger one"),
        ("ball.stl -o x.npz --margin -1", "margin"),
        ("ball.stl -o x.npz --resolution 9 --spacing 1", "--resolution and --spacing each say"),
        ("ball.stl -o x.npz --grid-like missing.nii", "there is no file missing.nii"),
        ("ball.stl -o x.npz --grid-like damaged.nii", "damaged.nii"),
        ("ball.stl -o x.npz --grid-like ball.stl", "does not end like a map"),
        ("ball.stl -o x.npz --resolution 100000", "GiB free"),
        ("ball.stl -o x.nii.gz --spacing 0.0001", "GiB free"),
        ("ball.stl -o x.npz --device tpu", "device"),
        ("ball.stl -o x.npz --device cuda:99", "cuda:99"),
    ],
)
def test_one_sentence_and_exit_code_2(words, expected, place, capsys):
    before = sorted(path.name for path in place.rglob("*"))
    assert main(["compute", *words.split()]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("sdm: ")
    assert expected in line
    # Nothing was made, but for a folder to write to.
    assert [name for name in sorted(path.name for path in place.rglob("*")) if name not in before] in ([], ["maps"])


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is there")
def test_no_cuda_device(place, capsys):
    assert main(["compute", "ball.stl", "-o", "x.npz", "--device", "cuda"]) == 2
    assert "no CUDA device is there" in capsys.readouterr().err


NAMES = ["missing.stl", "mesh.foo", "damaged.glb", "points.xyz", "nan.off", "range.ply", "empty"]


@pytest.mark.parametrize("name", NAMES)
def test_inspect_too(name, place, capsys):
    for words in (["inspect", name], ["inspect", name, "--json"]):
        assert main(words) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert len(said.err.splitlines()) == 1


def test_a_zarr_larger_than_memory_is_not_refused(place, monkeypatch):
    """Only the first slab is made, which is all that has to fit."""
    from sdm.engine.mesh_index import MeshIndex

    class Asked(Exception):
        pass

    def slabs(self, grid, max_bytes, *, ambiguous=None):
        assert grid.nbytes > 10**12
        assert max_bytes < 2**33
        raise Asked

    monkeypatch.setattr(MeshIndex, "slabs", slabs)
    with pytest.raises(Asked):
        main(["compute", "ball.stl", "-o", "x.zarr", "--resolution", "8000"])
    assert not (place / "x.zarr").exists()


def test_a_zarr_whose_slabs_do_not_fit_is_refused(place, capsys):
    assert main(["compute", "ball.stl", "-o", "x.zarr", "--resolution", "1000000"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "32 layers at a time" in line
    assert "GiB free" in line


def test_bad_files_in_a_folder_do_not_stop_the_others(place, capsys):
    """Every kind of bad file at once, and one good mesh."""
    (place / "file").unlink()
    assert main(["compute", ".", "-o", "maps", "--resolution", "8", "--device", "cpu", "--format", "npz"]) == 2
    assert sorted(str(path.relative_to(place / "maps")) for path in (place / "maps").rglob("*.npz")) == [
        "ball.npz",
        "one/ball.npz",
    ]
    said = capsys.readouterr().err
    for name in ("nan.off", "range.ply", "damaged.glb", "point.off"):
        assert name in said
    assert "4 of 6 meshes failed" in said


def test_grid_like_a_map(place, capsys):
    from sdm.core.signed_distance_map import SDM

    save(SDM(torch.zeros(1, 1, 1), Grid((0, 0, 0), (1, 1, 1), (1, 1, 1))), place / "one.npz")
    assert main(["compute", "ball.stl", "-o", "x.npz", "--grid-like", "one.npz", "--device", "cpu"]) == 0
    with np.load("x.npz") as found:
        assert found["values"].shape == (1, 1, 1)
