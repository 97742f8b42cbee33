"""`sdm predict`, and what answers it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.cli import main
from sdm.errors import FormatError, MeshError
from sdm.shapes import Cochlea
from sdm.surrogate import GRID, Predictor, SDMNNPlus, exact_map, predict, save_weights, shipped_weights
from sdm.surrogate.infer import predict as shipped
from sdm.surrogate.train.validation import validation_theta

WORDS = ["predict", "--a", "3.7", "--alpha", "0.45", "--b", "0.146", "--phi", "-0.6"]
THETA = [3.7, 0.45, 0.146, -0.6]


@pytest.fixture
def weights(tmp_path):
    torch.manual_seed(0)
    save_weights(SDMNNPlus(modes=3, channels=4), tmp_path / "w.safetensors")
    return tmp_path / "w.safetensors"


def test_the_command_writes_what_the_model_says(weights, tmp_path, capsys):
    out = tmp_path / "c.nii.gz"
    assert main([*WORDS, "--weights", str(weights), "-o", str(out)]) == 0
    assert "80 x 64 x 40 voxels of 0.2 mm, surrogate" in capsys.readouterr().out
    field = sdm.load(out)
    torch.testing.assert_close(field.values, Predictor(weights, backend="torch").predict(THETA).values)
    np.testing.assert_allclose(field.grid.affine, GRID.affine, atol=1e-6)


def test_outside_the_box_it_refuses_or_is_exact(weights, tmp_path, capsys):
    out = tmp_path / "c.npz"
    outside = ["predict", "--a", "5.5", "--alpha", "0.45", "--b", "0.146", "--phi", "0", "-o", str(out)]
    assert main([*outside, "--weights", str(weights)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "a of theta is 5.5; cochlea takes 2 to 5 mm" in line
    assert not out.exists()
    assert main([*outside, "--exact"]) == 0
    assert (sdm.load(out).values < 0).sum() > 1000


def test_exact_maps_are_the_engines():
    field = exact_map(THETA)
    assert field.grid == GRID
    wanted = sdm.signed_distance_map(Cochlea().mesh(THETA), GRID, device="cpu")
    assert torch.equal(field.values, wanted.values)
    # A shape that the grid does not hold has one of its own, of the same voxels.
    large = exact_map([8.0, 0.4, 0.1, 0.0])
    assert large.grid != GRID
    assert large.grid.spacing == GRID.spacing
    with pytest.raises(MeshError, match="no cochlea"):
        exact_map([0.0, 0.4, 0.1, 0.0])
    with pytest.raises(MeshError, match="four finite"):
        exact_map([3.0, float("nan"), 0.1, 0.0])


def test_without_weights_it_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.setattr(shipped, "WEIGHTS", tmp_path)
    with pytest.raises(FormatError, match="sdm train sdmnn"):
        shipped.load_surrogate()


@pytest.mark.skipif(shipped_weights() is None, reason="no weights are shipped yet")
def test_the_shipped_surrogate_is_as_good_as_its_card_says():
    theta = validation_theta(Cochlea())[[0, 7, 15, 20, 40, 60]]
    for row in theta:
        field = predict(row)
        exact = exact_map(row.tolist()).values
        error = (field.values - exact).abs()
        assert error.mean() < 0.04
        assert error[exact.abs() < 0.5].mean() < 0.04
        inside, wanted = field.values < 0, exact < 0
        assert 2 * (inside & wanted).sum() / (inside.sum() + wanted.sum()) > 0.95
    path = shipped_weights()
    assert path is not None
    assert path.stat().st_size <= 8e6
