from __future__ import annotations

import os
import signal

import nibabel as nib
import numpy as np
import pytest
import torch
import trimesh

from sdm.cli import main
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.io import FORMATS, load, load_mesh, save
from tests.helpers.processes.forked import Forked

BALL = trimesh.creation.icosphere(1)
AT = np.array([-40, -30, 50])
SMALL = ["--resolution", "12", "--device", "cpu"]


@pytest.fixture
def ball(tmp_path):
    BALL.export(tmp_path / "ball.stl")
    return tmp_path / "ball.stl"


@pytest.fixture
def folder(tmp_path):
    """Three meshes, one bad file and a note."""
    place = tmp_path / "meshes"
    place.mkdir()
    BALL.export(place / "a.stl")
    (place / "bad.off").write_text("OFF\nthree\n")
    opened = BALL.copy()
    opened.update_faces(opened.triangles_center[:, 2] > 0)
    opened.export(place / "open.ply")
    inside_out = BALL.copy()
    inside_out.invert()
    inside_out.export(place / "turned.obj")
    (place / "notes.txt").write_text("mine")
    return place


def run(*words: object) -> int:
    return main(["compute", *map(str, words)])


@pytest.mark.parametrize("ending", FORMATS)
def test_one_mesh_to_one_file(ending, ball, tmp_path, capsys):
    out = tmp_path / f"map.{ending}"
    assert run(ball, "-o", out, *SMALL) == 0
    mesh = load_mesh(ball)
    expected = signed_distance_map(mesh, Grid.around(mesh, resolution=12), device="cpu")
    again = load(out)
    assert (again.grid, again.ambiguous_voxels) == (expected.grid, 0)
    np.testing.assert_array_equal(again.numpy(), expected.numpy())
    said = capsys.readouterr()
    for words in ("ball.stl", "80 triangles", "12 x 12 x 12 voxels", " s on cpu", str(out)):
        assert words in said.out
    assert said.err == ""


def test_grids(ball, tmp_path):
    mesh = load_mesh(ball)
    out = tmp_path / "map.npz"
    assert run(ball, "-o", out, "--spacing", "0.3", "--margin", "0.2") == 0
    assert load(out).grid == Grid.around(mesh, spacing=0.3, margin=0.2)
    assert run(ball, "-o", out, "--spacing", "0.3", "0.2", "0.5") == 0
    assert load(out).grid == Grid.around(mesh, spacing=(0.3, 0.2, 0.5))
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    grid = Grid((-1, -1, -1), (0.3, 0.4, 0.5), (5, 6, 7), turn)
    save(signed_distance_map(mesh, grid), tmp_path / "image.nii.gz")
    assert run(ball, "-o", out, "--grid-like", tmp_path / "image.nii.gz") == 0
    assert load(out).grid == grid


def test_an_image_that_does_not_say_how_it_lies(ball, tmp_path, capsys):
    image = nib.Nifti1Image(np.zeros((5, 6, 7), np.float32), np.diag([0.4, 0.5, 0.6, 1.0]))
    for code in (1, 0):
        image.set_qform(image.affine, code)
        image.set_sform(image.affine, code)
        nib.save(image, tmp_path / f"code-{code}.nii.gz")
        assert run(ball, "-o", tmp_path / "map.npz", "--grid-like", tmp_path / f"code-{code}.nii.gz") == 0
        said = capsys.readouterr().err
        assert ("code-0.nii.gz does not say how it lies in space" in said) == (code == 0)


def test_the_default_resolution(ball, tmp_path):
    from sdm.cli.maps.map_settings import Settings

    assert run(ball, "-o", tmp_path / "map.npz", "--device", "cpu") == 0
    assert load(tmp_path / "map.npz").grid.shape == (128, 128, 128)
    assert Settings.__dataclass_fields__["resolution"].type == "int | tuple[int, ...] | None"


def test_a_folder_of_meshes(folder, tmp_path, capsys):
    out = tmp_path / "maps"
    assert run(folder, "-o", out, *SMALL) == 2
    assert sorted(path.name for path in out.iterdir()) == ["a.nii.gz", "open.nii.gz", "turned.nii.gz"]
    said = capsys.readouterr()
    assert len(said.out.splitlines()) == 3
    *warnings, failure, total = said.err.splitlines()
    assert "bad.off cannot be read" in failure
    assert total == "sdm: 1 of 4 meshes failed; the others are done"
    turned, opened = sorted(warnings, key=lambda line: "open.ply" in line)
    assert "turned.obj: the mesh is inside out" in turned
    assert "--orient auto" in turned
    assert "open.ply is not closed" in opened
    assert f"{load(out / 'open.nii.gz').ambiguous_voxels:,} voxels" in opened


def test_inside_out_meshes_can_be_turned(folder, tmp_path, capsys):
    good, turned = tmp_path / "good.npz", tmp_path / "turned.npz"
    assert run(folder / "a.stl", "-o", good, *SMALL) == 0
    assert run(folder / "turned.obj", "-o", turned, *SMALL, "--orient", "auto") == 0
    np.testing.assert_allclose(load(turned).numpy(), load(good).numpy(), atol=1e-6)
    assert "was inside out and has been turned" in capsys.readouterr().err
    assert run(folder / "turned.obj", "-o", turned, *SMALL) == 0
    assert (load(turned).values > 0).all()


@pytest.fixture
def image(tmp_path):
    """An image in RAS, over a ball of 20 mm at (-40, -30, 50)."""
    grid = Grid((-72, -62, 18), (4, 4, 4), (17, 17, 17))
    save(SDM(torch.zeros(grid.shape), grid), tmp_path / "ct.nii.gz")
    return tmp_path / "ct.nii.gz"


@pytest.mark.parametrize(
    ("factors", "words", "mends"),
    [
        ((-1, -1, 1), "--mesh-space lps", ["--mesh-space", "lps"]),
        ((1e-3, 1e-3, 1e-3), "--scale 1000", ["--scale", "1000"]),
        ((1e3, 1e3, 1e3), "--scale 0.001", ["--scale", "0.001"]),
        ((-1e-3, -1e-3, 1e-3), "outside the grid's", ["--scale", "1000", "--mesh-space", "lps"]),
    ],
)
def test_meshes_that_miss_the_image(factors, words, mends, image, tmp_path, capsys):
    ball = trimesh.creation.icosphere(2, radius=20)
    out, mesh = tmp_path / "map.npz", tmp_path / "ball.ply"
    trimesh.Trimesh((ball.vertices + AT) * factors, ball.faces, process=False).export(mesh)
    assert run(mesh, "-o", out, "--grid-like", image) == 0
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "ball.ply: no voxel is inside" in said
    assert words in said
    assert load(out).inside_voxels == 0
    assert run(mesh, "-o", out, "--grid-like", image, *mends) == 0
    assert capsys.readouterr().err == ""
    assert 480 < load(out).inside_voxels < 530
    # A stream of slabs counts them too.
    assert run(mesh, "-o", tmp_path / "map.zarr", "--grid-like", image) == 0
    assert capsys.readouterr().err == said


def test_a_reversed_ball_with_a_hole(image, tmp_path, capsys):
    ball = trimesh.creation.icosphere(2, radius=20)
    out, mesh = tmp_path / "map.npz", tmp_path / "ball.ply"
    trimesh.Trimesh(ball.vertices + AT, ball.faces[1:, ::-1], process=False).export(mesh)
    assert run(mesh, "-o", out, "--grid-like", image) == 0
    said = capsys.readouterr().err
    assert "--orient auto" in said
    assert "no voxel is ambiguous" not in said
    assert load(out).inside_voxels == 0
    assert run(mesh, "-o", out, "--grid-like", image, "--orient", "auto") == 0
    said = capsys.readouterr().err
    assert "was inside out and has been turned" in said
    assert "not closed" in said
    assert 480 < load(out).inside_voxels < 530


def test_inspect_and_compute_say_the_same(tmp_path, capsys):
    ball = trimesh.creation.icosphere(2)
    flip = np.random.default_rng(0).random(len(ball.faces)) < 0.5
    far = np.concatenate([ball.vertices, ball.vertices + 4])
    cases = {
        "half": (ball.vertices, np.where(flip[:, None], ball.faces[:, ::-1], ball.faces)),
        "parts": (far, np.concatenate([ball.faces, ball.faces[:, ::-1] + len(ball.vertices)])),
        "hole": (ball.vertices, ball.faces[1:, ::-1]),
        "flat": (ball.vertices, np.concatenate([ball.faces[:5], ball.faces[:5, ::-1]])),
    }
    for name, (vertices, faces) in cases.items():
        path = tmp_path / f"{name}.ply"
        trimesh.Trimesh(vertices, faces, process=False).export(path)
        assert run(path, "-o", tmp_path / "map.npz", *SMALL) == 0
        said = capsys.readouterr().err.splitlines()[0].partition(f"{name}.ply: ")[2]
        assert said
        assert main(["inspect", str(path)]) == 0
        assert f"- {said}" in capsys.readouterr().out.splitlines()
        assert run(path, "-o", tmp_path / "map.npz", *SMALL, "--orient", "auto") == 0
        again = capsys.readouterr().err
        assert (said in again) == (name == "flat")
        assert ("turned" in again) == (name != "flat")


def test_a_scale_that_is_none_is_refused(folder, tmp_path, capsys):
    for scale in ("0", "-1", "nan"):
        assert run(folder / "a.stl", "-o", tmp_path / "a.npz", "--scale", scale) == 2
        assert "--scale" in capsys.readouterr().err


def test_several_meshes_and_a_format(folder, tmp_path):
    out = tmp_path / "deep" / "maps"
    assert run(folder / "a.stl", folder / "turned.obj", "-o", out, *SMALL, "--format", "npz") == 0
    assert sorted(path.name for path in out.iterdir()) == ["a.npz", "turned.npz"]


def test_one_mesh_into_a_folder(ball, tmp_path):
    (tmp_path / "here.v2").mkdir()
    for out in ("new", "here.v2"):
        assert run(ball, "-o", tmp_path / out, *SMALL, "--format", "nrrd") == 0
        assert (tmp_path / out / "ball.nrrd").is_file()


def test_meshes_that_differ_by_their_ending_keep_it(ball, tmp_path):
    BALL.export(tmp_path / "ball.off")
    assert run(ball, tmp_path / "ball.off", "-o", tmp_path / "maps", *SMALL, "--format", "npz") == 0
    assert sorted(path.name for path in (tmp_path / "maps").iterdir()) == ["ball.off.npz", "ball.stl.npz"]


def test_resume_skips_what_is_finished(folder, tmp_path, capsys):
    out = tmp_path / "maps"
    assert run(folder, "-o", out, *SMALL) == 2
    first = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    (out / "open.nii.gz").write_bytes((out / "open.nii.gz").read_bytes()[:100])
    assert run(folder / "a.stl", "-o", out / "turned.nii.gz", "--spacing", "0.5") == 0
    capsys.readouterr()
    assert run(folder, "-o", out, *SMALL, "--resume") == 2
    assert "a.stl: " in capsys.readouterr().out
    second = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert second.keys() == first.keys()
    # One was finished, one is damaged, one is on another grid.
    assert second["a.nii.gz"] == first["a.nii.gz"]
    assert second["open.nii.gz"] != first["open.nii.gz"]
    assert load(out / "open.nii.gz").grid == Grid.around(load_mesh(folder / "open.ply"), resolution=12)
    assert load(out / "turned.nii.gz").grid.shape == (12, 12, 12)
    assert run(folder, "-o", out, *SMALL, "--resume", "--format", "npz") == 2
    assert (out / "a.npz").is_file()


@pytest.mark.parametrize("ending", FORMATS)
def test_resume_with_every_format(ending, ball, tmp_path, capsys):
    out = tmp_path / f"map.{ending}"
    assert run(ball, "-o", out, *SMALL) == 0
    capsys.readouterr()
    assert run(ball, "-o", out, *SMALL, "--resume") == 0
    assert "is there already" in capsys.readouterr().out


@pytest.mark.parametrize("ending", FORMATS)
def test_resume_makes_a_map_again_that_is_of_something_else(ending, folder, tmp_path, capsys):
    out = tmp_path / f"map.{ending}"
    # Of another mesh in the same place, of the mesh facing the other way, and of nothing that the file tells.
    words = ["-o", out, "--grid-like", tmp_path / "like.npz", "--device", "cpu", "--resume"]
    assert run(folder / "a.stl", "-o", tmp_path / "like.npz", *SMALL) == 0
    expected = {}
    for name, more in (("a.stl", []), ("turned.obj", []), ("turned.obj", ["--orient", "auto"]), ("open.ply", [])):
        for again in (False, True):
            capsys.readouterr()
            assert run(folder / name, *words, *more) == 0
            assert ("is there already" in capsys.readouterr().out) == again
        expected[name, *more] = load(out).numpy()
    assert (expected["turned.obj",] > 0).all()
    assert (expected["turned.obj", "--orient", "auto"] < 0).any()
    save(load(tmp_path / "like.npz"), out)
    assert run(folder / "open.ply", *words) == 0
    np.testing.assert_array_equal(load(out).numpy(), expected["open.ply",])
    # What is not inside out is not turned, and so is the same.
    assert run(folder / "a.stl", *words) == 0
    capsys.readouterr()
    assert run(folder / "a.stl", *words, "--orient", "auto") == 0
    assert "is there already" in capsys.readouterr().out


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_a_run_that_is_stopped_leaves_no_broken_map(number, code, tmp_path):
    trimesh.creation.icosphere(5).export(tmp_path / "ball.ply")
    words = ["compute", str(tmp_path / "ball.ply"), "-o", str(tmp_path / "map.zarr"), "--resolution", "400"]
    said = tmp_path / "said.txt"
    child = Forked(lambda: main([*words, "--device", "cpu"]), said)
    child.wait_for(lambda: list(tmp_path.glob(".map.zarr.*.part/zarr.json")))
    os.kill(child.pid, number)
    assert child.wait() == code
    assert "Traceback" not in said.read_text()
    assert not (tmp_path / "map.zarr").exists()
    left = [path.name for path in tmp_path.iterdir() if path.name not in ("ball.ply", "said.txt")]
    assert len(left) == (0 if number == signal.SIGINT else 1)
