"""sdm train deepsdf, sdm encode, sdm decode: from meshes to a model, to codes, and back to meshes."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli.app import main
from sdm.deepsdf import load_code
from sdm.deepsdf.infer import preconditioner


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model of ellipsoids, and one more ellipsoid."""
    folder = tmp_path_factory.mktemp("deepsdf")
    (folder / "meshes").mkdir()
    for number, sizes in enumerate([(3, 2, 2), (2, 3, 2), (2, 2, 3), (3, 3, 2)]):
        ball = trimesh.creation.icosphere(2)
        ball.apply_scale(sizes)
        ball.export(folder / "meshes" / f"{number}.ply")
    ball = trimesh.creation.icosphere(3)
    ball.apply_scale((3, 2.5, 2))
    ball.apply_translation((10, 0, 0))
    ball.export(folder / "new.ply")
    words = ["train", "deepsdf", str(folder / "meshes"), "--out", str(folder / "model")]
    words += ["--epochs", "100", "--points", "256", "--width", "32", "--device", "cpu"]
    assert main(words) == 0
    return folder


def test_a_mesh_becomes_a_code_and_the_code_a_mesh_where_it_was(work: Path, tmp_path: Path) -> None:
    model, code, out = work / "model" / "model.pt", tmp_path / "new.npz", tmp_path / "new.ply"
    assert main(["encode", str(work / "new.ply"), "-m", str(model), "-o", str(code), "--steps", "60"]) == 0
    for target, resolution in ((out.with_suffix(".stl"), "16"), (out.with_suffix(".obj"), "16"), (out, "48")):
        assert main(["decode", str(code), "-m", str(model), "-o", str(target), "--resolution", resolution]) == 0
        assert len(sdm.load_mesh(target)) > 0
    away = sdm.signed_distance(sdm.load_mesh(work / "new.ply"), sdm.load_mesh(out).vertices)
    assert away.abs().mean() < 0.15


def test_a_code_becomes_a_map_and_pictures(work: Path, tmp_path: Path) -> None:
    model, code = work / "model" / "model.pt", tmp_path / "new.npz"
    assert main(["encode", str(work / "new.ply"), "-m", str(model), "-o", str(code), "--steps", "5"]) == 0
    common = ["decode", str(code), "-m", str(model), "--resolution", "16", "-o"]
    assert main([*common, str(tmp_path / "map.npz")]) == 0
    field = sdm.load(tmp_path / "map.npz")
    assert field.grid.shape == (16, 16, 16)
    assert field.grid.origin[0] == pytest.approx(10 - 3 * 1.03, abs=0.02)
    assert main([*common, str(tmp_path / "one.png")]) == 0
    assert main([*common, str(tmp_path / "strip.png"), "--to", str(code), "--count", "2"]) == 0
    assert (tmp_path / "strip.png").stat().st_size > 0


def test_several_shapes_and_a_scan(work: Path, tmp_path: Path) -> None:
    model = str(work / "model" / "model.pt")
    meshes = [str(work / "meshes" / f"{n}.ply") for n in (0, 1)]
    assert main(["encode", *meshes, "-m", model, "-o", str(tmp_path / "codes"), "--steps", "3"]) == 0
    assert sorted(p.name for p in (tmp_path / "codes").iterdir()) == ["0.npz", "1.npz"]
    points = trimesh.load_mesh(work / "new.ply").vertices
    np.save(tmp_path / "scan.npy", points[points[:, 2] > 0])
    words = ["encode", str(tmp_path / "scan.npy"), "--scan", "--sphere", "10", "0", "0", "3.1", "-m", model]
    assert main([*words, "-o", str(tmp_path / "scan.npz"), "--steps", "3"]) == 0


def test_a_point_cloud_is_a_scan_like_the_array_of_its_points(work: Path, tmp_path: Path) -> None:
    points = trimesh.load_mesh(work / "new.ply").vertices.astype(np.float32)
    np.save(tmp_path / "scan.npy", points)
    trimesh.PointCloud(points).export(tmp_path / "scan.ply")
    for name in ("scan.npy", "scan.ply"):
        words = ["encode", str(tmp_path / name), "--scan", "-m", str(work / "model" / "model.pt"), "--steps", "3"]
        assert main([*words, "--device", "cpu", "-o", str(tmp_path / f"{name}.npz")]) == 0
    codes = [load_code(tmp_path / f"scan.{ending}.npz") for ending in ("npy", "ply")]
    assert torch.equal(codes[0].code, codes[1].code)


def test_shapes_of_one_name_lose_no_code(work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, out, ball = str(work / "model" / "model.pt"), tmp_path / "codes", work / "meshes" / "0.ply"
    (tmp_path / "0.ply").write_bytes(ball.read_bytes())
    words = ["-m", model, "-o", str(out), "--steps", "2"]
    assert main(["encode", str(ball), str(tmp_path / "0.ply"), *words]) == 2
    assert "several files are called 0.ply" in capsys.readouterr().err
    assert not out.exists()
    trimesh.load_mesh(ball).export(tmp_path / "0.stl")
    assert main(["encode", str(ball), str(ball), str(tmp_path / "0.stl"), *words]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["0.ply.npz", "0.stl.npz"]


def test_an_unfinished_training_is_not_begun_anew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "model.pt").write_bytes(b"mine")
    assert main(["train", "deepsdf", "cochlea", "-o", str(tmp_path), "--epochs", "1"]) == 2
    assert "keeps an unfinished training: --resume goes on with it; or remove it" in capsys.readouterr().err
    assert (tmp_path / "checkpoint" / "model.pt").read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["encode", "{new}", "-m", "{none}", "-o", "x.npz"], "is not there; train a model first"),
        (["encode", "{new}", "-m", "{model}", "-o", "x.ply"], "does not end like a code: use .npz"),
        (["encode", "{folder}", "-m", "{model}", "-o", "x"], "meshes is a folder; name its files"),
        (["encode", "{open}", "-m", "{model}", "-o", "x.npz"], "open.ply cannot be encoded: it is not closed (3 edges"),
        (["encode", "{new}", "{new}", "-m", "{model}", "-o", "x.npz"], "is one file, but 2 shapes were given"),
        (["encode", "{few}", "--scan", "-m", "{model}", "-o", "x.npz"], "has 50 points; at least 100 are needed"),
        (["encode", "{nan}", "--scan", "-m", "{model}", "-o", "x.npz"], "1 of the points are not finite"),
        (["encode", "{wide}", "--scan", "-m", "{model}", "-o", "x.npz"], "(N, 3), or (N, 6) with normals, is needed"),
        (
            ["encode", "{new}", "--scan", "--sphere", "0", "0", "0", "4", "-m", "{model}", "-o", "x.npz"],
            "642 of the 642 points of the scan are outside the sphere with centre (0.0, 0.0, 0.0) and radius 4.0",
        ),
        (["decode", "{short}", "-m", "{model}", "-o", "x.ply"], "the code has 3 numbers; this model's codes have"),
        (["decode", "{short}", "-m", "{model}", "-o", "x.ply", "--to", "{short}"], "does not end like a picture"),
        (["decode", "{new}", "-m", "{model}", "-o", "x.ply"], "is no code of a shape"),
        (
            ["decode", "{new}", "-m", "{model}", "-o", "x.step"],
            "cannot write .step: use one of .ply, .stl, .obj, .off, .glb",
        ),
        (
            ["train", "deepsdf", "cochlea", "-o", "x", "--variant", "published", "--width", "100"],
            "a width of 100 has no room for code and point: 260 or more are needed",
        ),
        (["train", "deepsdf", "cochlea", "-o", "x"], "say how long to train: --budget-s or --epochs"),
        (["train", "deepsdf", "nothing", "-o", "x", "--epochs", "1"], "neither a family"),
        (["train", "deepsdf", "cochlea", "-o", "x", "--budget-s", "0"], "a budget of 0 seconds trains nothing"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    from sdm.deepsdf import ShapeCode, save_code
    from sdm.deepsdf.samples import UnitSphere

    broken = np.ones((200, 3))
    broken[5, 2] = np.nan
    for name, array in (("few", np.ones((50, 3))), ("nan", broken), ("wide", np.ones((200, 4)))):
        np.save(tmp_path / f"{name}.npy", array)
    save_code(ShapeCode(torch.zeros(3), UnitSphere((0.0, 0.0, 0.0), 1.0)), tmp_path / "short.npz")
    places = {name: str(tmp_path / f"{name}.npy") for name in ("few", "nan", "wide")}
    places |= {"new": str(work / "new.ply"), "model": str(work / "model"), "none": str(tmp_path / "none.pt")}
    ball = trimesh.load_mesh(work / "new.ply")
    trimesh.Trimesh(ball.vertices, ball.faces[1:], process=False).export(tmp_path / "open.ply")
    places |= {"short": str(tmp_path / "short.npz"), "open": str(tmp_path / "open.ply"), "folder": str(work / "meshes")}
    filled = [word.format(**places) for word in words]
    filled[filled.index("-o") + 1] = str(tmp_path / filled[filled.index("-o") + 1])
    assert main(filled) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "x.ply").exists()


def test_a_place_that_cannot_be_is_refused_before_the_work(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from sdm import deepsdf
    from sdm.deepsdf import ShapeCode, save_code
    from sdm.deepsdf.samples import UnitSphere

    for name in ("encode_meshes", "encode_scan", "decode_mesh", "render", "train"):
        monkeypatch.setattr(deepsdf, name, pytest.fail)
    new, model, code = str(work / "new.ply"), str(work / "model"), str(tmp_path / "code.npz")
    size = deepsdf.DeepSDF.load(model, "cpu").code_size
    save_code(ShapeCode(torch.zeros(size), UnitSphere((0.0, 0.0, 0.0), 1.0)), code)
    (tmp_path / "file").touch()
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "net" / "model.pt").mkdir(parents=True)
    for words in (
        ["encode", new, "-m", model, "-o", str(tmp_path / "nowhere" / "new.npz")],
        ["encode", new, "-m", model, "-o", str(tmp_path / "folder.npz")],
        ["encode", new, "--scan", "-m", model, "-o", str(tmp_path / "folder.npz")],
        ["encode", new, str(work / "meshes" / "0.ply"), "-m", model, "-o", str(tmp_path / "file")],
        ["decode", code, "-m", model, "-o", str(tmp_path / "nowhere" / "new.ply")],
        ["decode", code, "-m", model, "-o", str(tmp_path / "nowhere" / "new.png")],
        ["train", "deepsdf", str(work / "meshes"), "-o", str(tmp_path / "file"), "--epochs", "1"],
        ["train", "deepsdf", str(work / "meshes"), "-o", str(tmp_path / "net"), "--epochs", "1"],
    ):
        assert main([*words, "--device", "cpu"]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_pickle_given_as_a_model_is_one_sentence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Torch's own warning about such files is not shown."""
    from sdm.deepsdf import ShapeCode, save_code
    from sdm.deepsdf.samples import UnitSphere

    save_code(ShapeCode(torch.zeros(3), UnitSphere((0.0, 0.0, 0.0), 1.0)), tmp_path / "code.npz")
    (tmp_path / "model.pt").write_bytes(pickle.dumps({"a": 1}))
    words = ["decode", str(tmp_path / "code.npz"), "-m", str(tmp_path / "model.pt"), "-o", str(tmp_path / "x.ply")]
    assert main(words) == 2
    said = capfd.readouterr().err
    assert said == f"sdm: {tmp_path / 'model.pt'} is no DeepSDF model, or it is damaged; train it again\n"


@pytest.fixture
def few_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the code's thousands of numbers: more than an ellipsoid needs."""
    monkeypatch.setattr(preconditioner, "MOST", 1000)


# Many seconds; deepsdf/infer/test_fit_deepsdf.py has quick fits of images, by the command too.
@pytest.mark.slow
@pytest.mark.usefixtures("few_numbers")
def test_size_and_code_are_fitted_to_an_image(work: Path, tmp_path: Path) -> None:
    truth, model = sdm.load_mesh(work / "new.ply"), str(work / "model" / "model.pt")
    grid = sdm.Grid((6.0, -4.0, -3.5), (0.65, 0.65, 0.65), (13, 13, 12))
    inside = torch.sigmoid(-sdm.signed_distance_map(truth, grid).values / 0.15)
    noise = torch.randn(grid.shape, generator=torch.Generator().manual_seed(0))
    image, out, surface = tmp_path / "image.nii.gz", tmp_path / "fit.json", tmp_path / "fit.ply"
    sdm.save(sdm.SDM(100 * inside + 5 * noise, grid), image)
    files = ["-o", str(out), "--mesh", str(surface), "--family", model, "--fine", "0.65", "--device", "cpu"]
    assert main(["fit", str(image), *files, "--picture", str(tmp_path / "fit.png")]) == 0
    found = json.loads(out.read_text())
    assert found["trusted"]
    assert list(found["theta"])[:2] == ["size", "code1"]
    assert found["theta"]["size"]["estimate"] == pytest.approx(3.09, rel=0.1)
    assert found["pose"]["translation_mm"] == pytest.approx([10, 0, 0], abs=0.3)
    assert float(sdm.signed_distance(truth, sdm.load_mesh(surface).vertices).abs().mean()) < 0.15


@pytest.mark.usefixtures("few_numbers")
def test_size_and_code_are_fitted_to_points(work: Path, tmp_path: Path) -> None:
    truth, surface = sdm.load_mesh(work / "new.ply"), tmp_path / "fit.ply"
    np.save(tmp_path / "some.npy", truth.vertices[::4].numpy())
    words = ["fit", "--points", str(tmp_path / "some.npy"), "-o", str(tmp_path / "fit.json"), "--mesh", str(surface)]
    assert main([*words, "--family", str(work / "model" / "model.pt"), "--device", "cpu"]) == 0
    assert float(sdm.signed_distance(truth, sdm.load_mesh(surface).vertices).abs().mean()) < 0.15


def test_an_image_of_nothing_has_no_fit(work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grid = sdm.Grid((0.0, 0.0, 0.0), (0.4, 0.4, 0.4), (16, 16, 16))
    noise = torch.randn(grid.shape, generator=torch.Generator().manual_seed(0))
    sdm.save(sdm.SDM(noise, grid), tmp_path / "image.nii.gz")
    words = ["fit", str(tmp_path / "image.nii.gz"), "-o", str(tmp_path / "fit.json"), "--device", "cpu", "--family"]
    assert main([*words, str(work / "model" / "model.pt")]) == 2
    assert "no shape of this family found" in capsys.readouterr().err
    assert not json.loads((tmp_path / "fit.json").read_text())["trusted"]
    assert main([*words, str(work / "model" / "model.pt"), "--triangles", "500"]) == 2
    assert "is a DeepSDF: --triangles and --mirror are for families of meshes" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "none.pt")]) == 2
    assert "none.pt" in capsys.readouterr().err
    assert main(["family", "check", str(work / "model" / "model.pt")]) == 2
    assert "has codes and no meshes" in capsys.readouterr().err
