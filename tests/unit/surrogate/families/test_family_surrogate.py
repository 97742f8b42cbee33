"""Surrogates of any family: training, card, folder and commands, on a family of a user's file and a shape model."""

from __future__ import annotations

import json

import pytest
import torch

import sdm
from sdm.cli import main
from sdm.shapes import load_family
from sdm.surrogate.families.family_file import FamilyPredictor
from sdm.surrogate.families.low_rank import LowRankSurrogate, count_of_terms, total_degree_terms
from sdm.surrogate.families.train_family import exact_maps, train_family

CODE = """
import torch
from sdm.shapes import Ellipsoid, Family, Parameter

class Egg(Family):
    parameters = (Parameter("a", 1.0, 2.0, "mm"), Parameter("b", 1.0, 1.5, "mm"), Parameter("c", 0.8, 1.2, "mm"))

    def __init__(self):
        made = Ellipsoid(triangles=300)
        theta = torch.tensor([[1.0, 1.0, 1.0] + [0.0] * (len(made.parameters) - 3)])
        self.points, self.triangles = made.vertices(theta)[0], made.triangles

    def vertices(self, theta):
        return self.points.to(theta) * theta[:, None, :]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("families")
    (folder / "egg.py").write_text(CODE)
    words = ["--budget-s", "1", "--resolution", "16", "--device", "cpu"]
    assert main(["train", "sdmnn", "--family", f"{folder}/egg.py:Egg", "-o", f"{folder}/run", *words]) == 0
    return folder


def test_a_user_s_family_is_learnt(place):
    card = json.loads((place / "run" / "card.json").read_text())
    # A fiftieth of a voxel of 0.26 mm after a second.
    assert card["mean"] < 0.03
    assert card["worst"]["mean"]["mean"] >= card["mean"]
    assert card["worst"]["dice"]["dice"] <= card["dice_least"] <= card["dice"]
    assert card["speed"]["torch"] > 0
    assert (place / "run" / "card.png").stat().st_size > 10_000
    assert "worst cases were found by search" in (place / "run" / "card.md").read_text()


def test_the_folder_answers_without_the_family(place, monkeypatch):
    predictor = FamilyPredictor(place / "run")
    found = predictor.predict([1.5, 1.2, 1.0])
    family = load_family(f"{place}/egg.py:Egg")
    exact = exact_maps(family, torch.tensor([[1.5, 1.2, 1.0]]), found.grid, torch.device("cpu"))[0]
    assert float((found.values - exact).abs().mean()) < 0.03


def test_predict_takes_parameters_by_name(place, tmp_path, capsys):
    out = tmp_path / "p.npz"
    assert main(["predict", "--model", f"{place}/run", "--set", "c=1", "a=1.5", "b=1.2", "-o", str(out)]) == 0
    assert sdm.load(out).values.shape == (16, 16, 16)
    assert main(["predict", "--set", "a=3.6", "alpha=.3", "b=.139", "phi=-.17", "-o", str(out)]) == 0
    assert sdm.load(out).values.shape == (80, 64, 40)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--model run --set a=1.5 b=1.2", "needs c too"),
        ("--model run --set a=1.5 b=1.2 c=1 d=2", "has no parameter 'd'; it has a, b, c"),
        ("--model run --set a=1.5 b=1.2 c=9", "c is 9; the surrogate was trained from 0.8 to 1.2"),
        ("--model run --set a=1.5 b=1.2 c=nan", "trained from 0.8 to 1.2"),
        ("--model run --set a=1.5 b c=1", "'b' is not NAME=NUMBER"),
        ("--model run --set a=1.5 a=1.5 b=1 c=1", "'a=1.5' is there twice"),
        ("--model nowhere --set a=1", "cannot be read"),
        ("--model run/surrogate.safetensors --set a=1", "is a file of a surrogate: give the folder that it is in, run"),
        ("--model no/surrogate.safetensors --set a=1", "is a file of a surrogate: give the folder that it is in, no"),
        ("--model run/surrogate.json --set a=1", "is a file of a surrogate: give the folder that it is in, run"),
        ("--model damaged --set a=1", "is no surrogate"),
        ("--model run --exact --set a=1", "--exact computes the map without a network"),
        ("--a 3.6", "the cochlea needs alpha, b, phi too"),
    ],
)
def test_bad_predictions_end_with_a_sentence(place, monkeypatch, capsys, words, expected):
    monkeypatch.chdir(place)
    damaged = place / "damaged"
    damaged.mkdir(exist_ok=True)
    (damaged / "surrogate.json").write_text('{"version": 1}')
    (damaged / "surrogate.safetensors").write_bytes((place / "run" / "surrogate.safetensors").read_bytes())
    assert main(["predict", *words.split(), "-o", "p.npz"]) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--family cochlea", "say how long to train"),
        ("--family torus --budget-s 1", "there is no family called 'torus'"),
        ("--family cochlea --budget-s -1", "a budget of -1 seconds trains nothing: give a positive number"),
    ],
)
def test_bad_trainings_end_with_a_sentence(tmp_path, capsys, words, expected):
    assert main(["train", "sdmnn", "-o", str(tmp_path / "run"), "--device", "cpu", *words.split()]) == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(("parameters", "degree"), [(1, 3), (3, 4), (10, 2), (64, 1)])
def test_polynomials_of_a_total_degree(parameters, degree):
    terms = total_degree_terms(parameters, degree)
    assert len(terms) == count_of_terms(parameters, degree) == len({tuple(row) for row in terms.tolist()})
    assert int(terms.sum(1).max()) == degree


def test_a_model_of_modes_with_many_parameters_has_gradients():
    model = LowRankSurrogate([-3.0] * 64, [3.0] * 64, (4, 4, 4), 5, 1)
    theta = torch.zeros(2, 64, requires_grad=True)
    assert model(theta).shape == (2, 1, 4, 4, 4)
    (found,) = torch.autograd.grad((model(theta) + model.coefficients(theta).sum()).sum(), theta)
    assert found.shape == theta.shape


def test_training_is_a_function_of_its_seed(place):
    family = load_family(f"{place}/egg.py:Egg")
    # So little time that both make the least number of maps, and no network.
    made = [train_family(family, family.grid(8), budget_s=1e-3, seed=5, report=lambda _: None)[0] for _ in range(2)]
    assert torch.equal(made[0].weights, made[1].weights)
    assert torch.equal(made[0].modes, made[1].modes)
