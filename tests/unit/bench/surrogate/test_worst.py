"""The search finds a place where a network is wrong."""

from __future__ import annotations

import json

import torch

from sdm.bench.surrogate import worst
from sdm.shapes import Cochlea
from sdm.surrogate.train import validation


class WrongNearOneEnd(torch.nn.Module):
    """Exact maps, moved by more the nearer `a` is to its upper end and `b` to its lower one."""

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        exact = torch.cat([b.sdm for b in validation.validation_batches(theta, "cpu")])
        share = (theta[:, 0] - 2) / 3 * (0.25 - theta[:, 2]) / 0.2
        return exact + 0.6 * share.view(-1, 1, 1, 1, 1)


def test_the_worst_place_is_found(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(validation, "make_family", lambda name: Cochlea(500))
    monkeypatch.setattr(worst, "_grid", lambda family, points: family.sample(2, seed=points, device="cpu"))
    monkeypatch.setattr(worst, "load_weights", lambda file, device: (WrongNearOneEnd(), {}))
    out = tmp_path / "worst.json"
    words = f"worst --weights x.safetensors --sobol 6 --turns 4 --places 2 --device cpu --out {out}"
    monkeypatch.setattr("sys.argv", words.split())
    worst.main()
    record = json.loads(out.read_text())
    assert record["shapes"] == 10 + 4 * 2 * worst.TRIES
    found = record["worst"][0]
    assert found["dice"] < record["sobol_worst"]
    assert found["theta"]["a"] > 4
    assert found["theta"]["b"] < 0.12
    assert "worst Dice" in capsys.readouterr().out
