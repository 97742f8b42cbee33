"""Misfit of points: told of another shape than the family's, not of noise, however large."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from sdm.cli.app import main
from sdm.cli.common import progress
from sdm.fit import ExactBackend
from sdm.fit.solve.fit_points import fit_points
from sdm.shapes import load_family


@pytest.fixture(scope="module")
def backend():
    return ExactBackend(load_family("cuboid"), "cpu")


@pytest.fixture(scope="module")
def cuboid():
    family = load_family("cuboid")
    middle = torch.tensor([[(p.low + p.high) / 2 for p in family.parameters]])
    return family.vertices(middle)[0].double().numpy()


# The last is more than the distance of neighbours, so that those on one side of the surface are nearer to each other.
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_noise_is_no_misfit(noise, backend, cuboid):
    points = cuboid + noise * np.random.default_rng(0).standard_normal(cuboid.shape)
    assert fit_points(points, backend).misfit == 0


def test_another_shape_is_told(backend, cuboid):
    ball = trimesh.creation.icosphere(3).vertices * 0.5
    found = fit_points(np.concatenate([ball, ball]), backend)
    assert 0.02 < found.misfit < 0.06
    (said,) = [line for line in found.warnings(backend.parameters) if "neighbouring points" in line]
    assert "the intervals are too narrow" in said
    assert found.record(backend.parameters)["misfit"] == found.misfit


def test_steps_are_told(backend, cuboid):
    told = []
    found = fit_points(cuboid, backend, report=lambda stage, step: told.append((stage, step)))
    assert found.misfit == 0
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert stages == [*(f"start {number} of 7" for number in range(1, 8)), "shape and pose"]
    assert [step for stage, step in told if stage == "shape and pose"] == list(range(found.steps + 1))


def test_command_tells_steps_in_a_log_and_the_misfit(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(progress, "LOG_INTERVAL", 0.0)
    trimesh.creation.icosphere(3).apply_scale(0.5).export("ball.ply")
    assert main(["fit", "--points", "ball.ply", "--family", "cuboid", "--device", "cpu", "-o", "fit.json"]) == 0
    said = capsys.readouterr().err
    assert "sdm: start 1 of 7, step 0, " in said
    assert "sdm: shape and pose, step 1, " in said
    assert "sdm: neighbouring points are off the shape alike" in said


@pytest.mark.parametrize("factor", [1e9, 1e-9])
def test_points_in_another_unit_have_no_answer(factor, tmp_path, monkeypatch, capsys):
    """Nothing of them is in the estimate, which is the middle of the ranges."""
    monkeypatch.chdir(tmp_path)
    np.save("points.npy", factor * np.random.default_rng(0).standard_normal((60, 3)))
    words = [
        "fit",
        "--points",
        "points.npy",
        "--family",
        "cuboid",
        "--device",
        "cpu",
        "-o",
        "fit.json",
        "--mesh",
        "f.ply",
    ]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "points.npy may be no shape of this family, or in another unit" in said or "did not converge" in said
    assert not (tmp_path / "f.ply").exists()
