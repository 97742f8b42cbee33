"""`sdm fit`: a report, a surface and a picture, or one sentence and exit code 2."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import sdm
from sdm.cli import main
from sdm.fit import ExactBackend, Scanner, random_state, simulate
from sdm.shapes import Cochlea

QUICK = ["--triangles", "1000", "--fine", "0.5", "--device", "cpu"]


def test_report_surface_and_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sdm.cli.common.progress.LOG_INTERVAL", 0.0)
    backend = ExactBackend(Cochlea(1_000), "cpu")
    truth = random_state(backend, 8, edge=0.3)
    image = simulate(backend, truth, Scanner(spacing=0.5, blur=0.3, noise=100.0), seed=0)
    # Any image will do; that its header calls it distances is no matter.
    sdm.SDM(image.values, image.grid).save(tmp_path / "scan.nii.gz")
    words = ["fit", str(tmp_path / "scan.nii.gz"), "-o", str(tmp_path / "fit.json"), "--blur", "0.3", *QUICK]
    words += ["--mesh", str(tmp_path / "fit.glb"), "--picture", str(tmp_path / "fit.png")]
    words += ["--residuals", str(tmp_path / "left.nii.gz"), "--estimate-formation"]
    words += ["--free-form", str(tmp_path / "free.ply")]
    assert main(words) == 0
    record = json.loads((tmp_path / "fit.json").read_text())
    assert record["trusted"]
    assert abs(record["theta"]["a"]["estimate"] - float(truth.theta[0])) < 0.15
    mesh = sdm.load_mesh(tmp_path / "fit.glb")
    middle = (mesh.vertices.amin(0) + mesh.vertices.amax(0)) / 2
    assert torch.linalg.vector_norm(middle.double() - truth.translation) < 1.5
    assert (tmp_path / "fit.png").stat().st_size > 10_000
    free = sdm.load_mesh(tmp_path / "free.ply")
    apart = sdm.MeshIndex(mesh, "cpu").signed_distance(free.vertices).abs()
    assert 1e-3 < float(apart.mean()) < 0.1
    said, log = capsys.readouterr()
    # All that takes time tells of its steps.
    stages = [line.removeprefix("sdm: ").partition(",")[0] for line in log.splitlines() if ", step " in line]
    assert list(dict.fromkeys(stages)) == ["start", "fine", "formation", "free form"]
    assert "free of the family" in said
    assert "90 % within" in said
    assert "counts" in said
    assert record["formation"]["p_value"] > 1e-3
    assert abs(record["blur"]["estimate"] - 0.3) < 0.1
    assert abs(float(sdm.load(tmp_path / "left.nii.gz").values.std()) - 100) < 10


def test_noise_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grid = sdm.Grid((-6, -5, -4), (0.6, 0.6, 0.6), (20, 18, 14))
    noise = torch.from_numpy(np.random.default_rng(0).standard_normal(grid.shape).astype(np.float32))
    sdm.SDM(noise, grid).save(tmp_path / "noise.nii.gz")
    words = ["fit", str(tmp_path / "noise.nii.gz"), "-o", str(tmp_path / "fit.json"), *QUICK]
    words += ["--free-form", str(tmp_path / "free.ply")]
    assert main([*words, "--mesh", str(tmp_path / "fit.ply")]) == 2
    assert "the fit gives no answer" in capsys.readouterr().err
    assert json.loads((tmp_path / "fit.json").read_text())["trusted"] is False
    assert not (tmp_path / "fit.ply").exists()
    assert not (tmp_path / "free.ply").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--fine", "0"], "fine is 0.0; a positive number is needed"),
        (["--turn", "0"], "turn is 0.0; a positive number is needed"),
        (["--turn", "nan"], "turn is nan; a positive number is needed"),
        (["--blur", "-1"], "blur is -1.0; a number of 0 or more is needed"),
        (["--components", "0", "1"], "components are (0, 1); 1 or more are needed inside and outside"),
    ],
)
def test_options_that_no_fit_can_be_made_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    grid = sdm.Grid((0, 0, 0), (0.5, 0.5, 0.5), (10, 10, 10))
    sdm.SDM(torch.rand(grid.shape), grid).save(tmp_path / "scan.nii.gz")
    assert main(["fit", str(tmp_path / "scan.nii.gz"), "-o", str(tmp_path / "fit.json"), *words]) == 2
    assert capsys.readouterr().err == f"sdm: {said}\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "fit.json", "--picture", "r.bmp"], "r.bmp does not end like a picture: use one of .png, .pdf, .svg"),
        (
            ["--out", "fit.json", "--mesh", "r.step"],
            "r.step does not end like a mesh that can be written: use one of .ply, .stl",
        ),
        (["--out", "r.json", "--mesh", "r.json"], "r.json does not end like a mesh"),
        (
            ["--out", "r.ply", "--mesh", "here/../r.ply"],
            "r.ply is given for two outputs, and one would replace the other",
        ),
        (["--out", "r.png", "--picture", "r.png"], "r.png is given for two outputs"),
        (["--out", "here"], "here cannot be written: a folder of that name is there"),
        (
            ["--out", "fit.json", "--mesh", "here/fit.ply"],
            "fit.ply cannot be written: a folder of",
        ),
    ],
)
def test_what_cannot_be_written_is_said_before_the_fit(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here" / "fit.ply").mkdir(parents=True)
    # There is no image: whatever is said was found out before it was read.
    assert main(["fit", "none.nii.gz", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert [path.name for path in tmp_path.rglob("*")] == ["here", "fit.ply"]


def test_a_missing_image_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(tmp_path / "none.nii.gz"), "-o", str(tmp_path / "fit.json")]) == 2
    assert "there is no file" in capsys.readouterr().err
