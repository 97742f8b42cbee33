"""Trainings learn, stop, and go on from where they stopped."""

from __future__ import annotations

import json
import math

import pytest
import torch

from sdm.cli.app import main
from sdm.errors import FormatError, SDMError
from sdm.shapes import Cochlea
from sdm.stream import SDMStream
from sdm.surrogate import GRID, SDMNN, Settings, Trainer
from sdm.surrogate.infer.weights_file import load_weights, save_weights
from sdm.surrogate.train import training as module
from sdm.surrogate.train.losses import eikonal, sobolev, surface_weighted
from sdm.surrogate.train.map_buffer import Replay

TINY = {
    "model": "sdmnn",
    "channels": 2,
    "loss": "mse",
    "recipe": "online",
    "batch_size": 2,
    "fresh": 1,
    "store": 3,
    "ema": 0.5,
}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """The family with few triangles."""
    monkeypatch.setattr(module, "make_family", lambda name: Cochlea(500) if name == "cochlea" else None)


def train(steps: int, **more) -> Trainer:
    options = {key: more.pop(key) for key in ("checkpoint", "curves") if key in more}
    trainer = Trainer(
        Settings(**{**TINY, **more}, steps=steps), device="cpu", validation=1, report=lambda line: None, **options
    )
    trainer.run()
    return trainer


def test_the_loss_falls_and_curves_are_written(tmp_path):
    train(12, curves=tmp_path / "curves", rate=1e-2)
    points = [json.loads(line) for line in (tmp_path / "curves" / "curve.jsonl").read_text().splitlines()]
    assert points[0]["step"] == 1
    assert points[-1]["step"] == 12
    assert points[-1]["mae"] < points[0]["mae"]


def test_a_training_may_begin_with_weights(tmp_path):
    first = train(3)
    weights = tmp_path / "first.safetensors"
    save_weights(first.ema.module, weights)
    still = train(1, start=str(weights), channels=8, rate=0.0)
    for name, value in load_weights(weights)[0].state_dict().items():
        assert torch.equal(still.model.state_dict()[name], value), name
    moved = train(1, start=str(weights), rate=1e-2)
    assert all(p.requires_grad for p in moved.model.parameters())
    assert not torch.equal(next(moved.model.parameters()), next(still.model.parameters()))
    with pytest.raises(FormatError, match="holds sdmnn, not sdmnn-plus"):
        Trainer(Settings(model="sdmnn-plus", start=str(weights)), device="cpu")


def test_a_training_goes_on_from_its_checkpoint(tmp_path):
    file = tmp_path / "a.checkpoint"
    train(2, checkpoint=file)
    spent = torch.load(file, weights_only=True)["seconds"]
    again = train(4, checkpoint=file)
    assert again.step == 4
    assert again.clock.seconds > spent + 1e-3
    # Six maps of three fresh ones a filling, and one a step: none is streamed twice.
    assert again.replay.stream.position == 3 + 2 + 3 + 2
    with pytest.raises(FormatError, match="other settings"):
        train(4, checkpoint=file, rate=0.5)


def test_a_training_that_diverges_says_so_and_keeps_its_checkpoint(tmp_path, monkeypatch):
    wild = tmp_path / "wild.checkpoint"
    with pytest.raises(SDMError, match="the loss is not finite at step 1: lower"):
        train(4, checkpoint=wild, rate=1e30)
    assert not wild.exists()
    file = tmp_path / "a.checkpoint"
    train(2, checkpoint=file)
    good = file.read_bytes()
    right = Trainer._loss
    monkeypatch.setattr(Trainer, "_loss", lambda *given: tuple(x * math.nan for x in right(*given)))
    with pytest.raises(SDMError, match="lower the learning rate"):
        train(4, checkpoint=file)
    assert file.read_bytes() == good


def test_the_last_line_says_the_last_loss(tmp_path):
    lines = []
    for _ in range(2):
        settings = Settings(**TINY, steps=2)
        Trainer(settings, device="cpu", validation=1, checkpoint=tmp_path / "a", report=lines.append).run()
    assert not any("nan" in line for line in lines)
    assert "100 %: loss " in lines[-3]
    # There was no step any more.
    assert "100 %: validation " in lines[-1]


def test_what_is_no_checkpoint_is_one_sentence(tmp_path):
    file = tmp_path / "a.checkpoint"
    others = [b"junk", b"", {"settings": {"steps": 3}}, {"settings": "no JSON"}, {"other": 1}, [1], torch.zeros(3)]
    for other in others:
        torch.save(other, file)
        if isinstance(other, bytes):
            file.write_bytes(other)
        with pytest.raises(
            FormatError, match=r"a\.checkpoint is not a checkpoint of a training of a surrogate: remove it"
        ):
            train(1, checkpoint=file)


def test_a_checkpoint_that_cannot_be_written_is_found_before_any_map_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "SDMStream", None)
    with pytest.raises(FormatError, match=r"the folder .*none is not there; make it first"):
        train(1, checkpoint=tmp_path / "none" / "a.checkpoint")


def test_weights_to_begin_with_are_not_written_over(tmp_path, capsys):
    weights = tmp_path / "sdmnn-online.safetensors"
    save_weights(SDMNN(channels=2), weights)
    before = weights.read_bytes()
    words = ["--model", "sdmnn", "--recipe", "online", "--steps", "1", "--store", "2"]
    assert main(["train", "sdmnn", "-o", str(tmp_path), *words, "--start", str(weights)]) == 2
    assert "sdmnn-online.safetensors is an input too, and would be lost" in capsys.readouterr().err
    assert weights.read_bytes() == before


def test_a_training_ends_with_its_budget():
    assert train(10**9, budget_s=0.01).step <= 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"recipe": "all"},
        {"loss": "l3"},
        {"model": "pod-chebyshev"},
        {"batch_size": 0},
        {"modes": 0},
        {"channels": 0},
        {"rate": -1e-3},
        {"rate": math.inf},
        {"fill_share": -0.1},
        {"warm_share": math.nan},
        {"sobolev": -1.0},
        {"surface": math.nan},
        {"modes": 30, "store": 30},
        {"modes": 625, "recipe": "static"},
    ],
)
def test_wrong_settings_are_one_sentence(wrong):
    with pytest.raises(SDMError):
        Settings(**wrong)


def test_the_store_keeps_the_latest_maps():
    stream = SDMStream(Cochlea(500), GRID, 2, sampler="uniform", device="cpu", rank=0, world_size=1)
    replay = Replay(stream, 3)
    replay.fill()
    assert replay.made == 4
    latest = stream.sample([3, 1, 2])
    torch.testing.assert_close(replay.theta, latest.theta)
    assert (replay.maps.float() - latest.sdm).abs().max() < 0.005
    once, again, other = (replay.at(replay.draw(4, step))[0] for step in (7, 7, 8))
    assert torch.equal(once, again)
    assert not torch.equal(once, other)


def test_what_lost_most_is_drawn_more_often():
    stream = SDMStream(Cochlea(500), GRID, 4, sampler="uniform", device="cpu", rank=0, world_size=1)
    replay = Replay(stream, 4)
    replay.fill()
    replay.lost.copy_(torch.tensor([0.0, 0.01, 0.04, 0.0]))
    rows = replay.draw(200, 1, hard=100)[100:]
    assert set(rows.tolist()) <= {1, 2}
    assert (rows == 2).sum() > 80
    replay.renew()
    assert torch.allclose(replay.lost, torch.full((4,), 0.0125))


def test_losses_are_zero_for_exact_maps_alone():
    family, theta = Cochlea(500), torch.tensor([[3.5, 0.5, 0.14, 0.2]])
    exact = next(iter(SDMStream(family, GRID, 1, device="cpu", rank=0, world_size=1))).sdm
    assert surface_weighted(exact, exact, 4.0) == 0
    assert surface_weighted(exact + 0.1, exact, 4.0) > 0.1
    assert eikonal(exact, exact) < 0.05
    assert eikonal(2 * exact, exact) == pytest.approx(1, abs=0.05)

    class Exact(torch.nn.Module):
        factor = 1.0

        def forward(self, at):
            from sdm.engine.many import signed_distance_maps

            maps = signed_distance_maps(family.vertices(at), family.faces, GRID, device="cpu")[:, None]
            return self.factor * maps

    model = Exact()
    assert float(sobolev(model, family, theta, torch.Generator().manual_seed(0)).detach()) == pytest.approx(0, abs=1e-9)
    model.factor = 1.5
    assert float(sobolev(model, family, theta, torch.Generator().manual_seed(0)).detach()) > 1e-6
