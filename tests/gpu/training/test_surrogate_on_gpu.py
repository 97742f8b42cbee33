"""Training of a surrogate on a GPU: recorded steps are steps, and a training goes on from its checkpoint."""

from __future__ import annotations

import pytest
import torch

from sdm.shapes import Cochlea
from sdm.surrogate import Settings, Trainer
from sdm.surrogate.train import training as module
from sdm.surrogate.train.recorded_step import FIRST, RecordedStep

pytestmark = pytest.mark.gpu


def descent(record: bool, steps: int) -> list[float]:
    """Losses of a linear model, the first of them at the step that follows those before a recording."""
    torch.manual_seed(0)
    model = torch.nn.Linear(3, 1).cuda()
    rate = torch.zeros((), device="cuda")
    optimizer = torch.optim.AdamW([{"params": model.parameters(), "lr": rate}], fused=True, capturable=True)
    x = torch.randn(8, 3, device="cuda")

    def work(inputs):
        loss = (model(inputs) - inputs.sum(1, keepdim=True)).square().mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        return (loss.detach(),)

    rate.fill_(0.01)
    if record:
        step = RecordedStep(work, (x,))
    else:
        step = work
        for _ in range(FIRST):
            work(x)
    losses = []
    for number in range(steps):
        rate.fill_(0.01 / (1 + number))
        losses.append(float(step(x + number)[0]))
    return losses


def test_recorded_steps_are_steps():
    assert descent(True, 6) == pytest.approx(descent(False, 6), rel=1e-5)


def test_a_training_goes_on_from_its_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "make_family", lambda name: Cochlea(500))
    lines = []

    def run(steps):
        settings = Settings(
            modes=4, channels=8, recipe="ends", batch_size=2, fresh=0, store=64, budget_s=60.0, fill_share=0.1,
            warm_share=0.02, flips=0.3, hard=0.5, sobolev_every=3, steps=steps, rate=1e-3,
        )  # fmt: skip
        trainer = Trainer(settings, validation=2, checkpoint=tmp_path / "a", report=lines.append)
        trainer.run()
        return trainer

    run(8)
    again = run(16)
    assert again.step == 16
    assert "100 %" in lines[-1]
    assert all(p.isfinite().all() for p in again.model.parameters())
    for kept, own in zip(again.ema.module.parameters(), again.model.parameters(), strict=True):
        assert not torch.equal(kept, own)
