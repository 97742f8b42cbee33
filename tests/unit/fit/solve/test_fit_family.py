"""Fits of any family, to images and to points: a user's file, a shape model, a family of another size."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli import main
from sdm.errors import SDMError
from sdm.fit import ExactBackend, FitOptions, Scanner, random_state, simulate
from sdm.fit.model.scaled_family import ScaledFamily, factor_of
from sdm.fit.solve.fit_family import fit_family
from sdm.fit.solve.fit_points import fit_points
from sdm.fit.solve.initial import _units
from sdm.shapes import StatisticalShape


@pytest.fixture(scope="module")
def balls() -> StatisticalShape:
    """Ellipsoids of about 8 mm, whose half-lengths differ."""
    small = StatisticalShape.example()
    size = torch.tensor([4.0, 3.2, 2.6])
    return StatisticalShape(small.mean * size, small.modes, 4 * small.deviations, small.faces)


def image_of(family):
    backend = ExactBackend(family, "cpu")
    state = random_state(backend, seed=1, edge=0.2)
    grid = sdm.Grid((-6.2, -6.1, -6.3), (0.8,) * 3, (16, 16, 16))
    return state, simulate(backend, state, Scanner(spacing=0.8, blur=0.4, noise=100), seed=1, grid=grid)


def test_a_fit_of_larger_shapes_is_the_same_in_their_lengths(balls):
    state, image = image_of(balls)
    large = ScaledFamily(balls, 16.0)
    assert factor_of(large) == 1 / 16
    grid = sdm.Grid([16 * x for x in image.grid.origin], [16 * x for x in image.grid.spacing], image.grid.shape)
    options = FitOptions(blur=0.4 * 16, fine=0.4 * 16, shift=80)
    found = fit_family(image.values, grid, large, options=options, device="cpu")
    assert found.trusted
    torch.testing.assert_close(found.state.theta, state.theta, atol=0.1, rtol=0)
    middle = 16 * state.to_world(torch.zeros(1, 3, dtype=torch.float64))[0]
    torch.testing.assert_close(found.state.to_world(torch.zeros(1, 3).double())[0], middle, atol=1.0, rtol=0)


def test_points_with_noise_and_outliers_give_shape_and_noise(balls):
    theta = torch.tensor([[1.0, -1.0, 0.5]])
    points = balls.vertices(theta)[0].double().numpy()
    random = np.random.default_rng(0)
    points = points + 0.02 * random.standard_normal(points.shape) + [10.0, -4.0, 2.0]
    points[:5] += 1.5
    found = fit_points(points, ExactBackend(balls, "cpu"))
    assert found.converged
    assert found.noise == pytest.approx(0.02, rel=0.25)
    torch.testing.assert_close(found.posterior.state.theta, theta[0].double(), atol=0.15, rtol=0)


def test_points_that_no_fit_can_be_made_with_are_refused(balls):
    backend = ExactBackend(balls, "cpu")
    for points, expected in (
        (np.zeros((5, 3)), "20 to 200,000 points is needed"),
        (np.zeros((50, 2)), r"\(N, 3\)"),
        (np.zeros((50, 3)), "all points are at one place"),
        (np.full((50, 3), np.nan), "is not finite"),
    ):
        with pytest.raises(SDMError, match=expected):
            fit_points(points, backend)


def test_starts_of_many_parameters_are_few():
    assert len(_units(4)) == 17
    assert len(_units(40)) == 17
    assert all(len(unit) == 40 for unit in _units(40))


def test_commands_fit_images_and_points(balls, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    balls.save("balls.npz")
    _, image = image_of(balls)
    sdm.save(sdm.SDM(image.values.float(), image.grid), "ct.nii.gz")
    words = ["--family", "balls.npz", "--device", "cpu", "--mesh", "fit.ply", "-o", "fit.json"]
    assert main(["fit", "ct.nii.gz", "--fine", "0.4", "--estimate-blur", *words]) == 0
    said = capsys.readouterr().out
    assert "mode1" in said
    assert "blur   0." in said, said
    assert sdm.load_mesh("fit.ply").faces.shape == balls.faces.shape
    cloud = balls.vertices(torch.tensor([[0.5, 0.0, 0.0]]))[0].numpy()
    trimesh.PointCloud(cloud).export("scan.ply")
    assert main(["fit", "--points", "scan.ply", *words]) == 0
    found = json.loads((tmp_path / "fit.json").read_text())
    assert found["theta"]["mode1"]["estimate"] == pytest.approx(0.5, abs=0.02)
    assert found["warnings"] == []
    np.save("scan.npy", cloud)
    capsys.readouterr()
    assert main(["fit", "--points", "scan.npy", *words]) == 0
    assert capsys.readouterr().err == ""
    # Of a much thinner shape.
    np.save("scan.npy", cloud * [0.3, 1, 1])
    main(["fit", "--points", "scan.npy", *words])
    assert "is at an end of its range" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("", "give an image, or --points FILE"),
        ("ct.nii.gz --points a.npy", "give an image or --points, and not both"),
        ("--points none.ply --family cuboid", "cannot be read"),
        ("--points junk.npy", "is no .npy file of numbers"),
        ("--points a.npy --picture p.png", "--picture is of an image's fit"),
        ("ct.nii.gz --family torus", "there is no family called 'torus'"),
        ("ct.nii.gz --family cuboid --backend hybrid", "are for images of the cochlea"),
        ("--points flat.npy", "(N, 3), or (N, 6) with normals, is needed"),
    ],
)
def test_bad_input_ends_with_a_sentence(tmp_path, monkeypatch, capsys, words, expected):
    monkeypatch.chdir(tmp_path)
    np.save("a.npy", np.zeros((50, 3)))
    np.save("flat.npy", np.zeros(50))
    (tmp_path / "junk.npy").write_bytes(b"junk")
    assert main(["fit", *words.split(), "-o", "fit.json", "--device", "cpu"]) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert said.count("\n") == 1
