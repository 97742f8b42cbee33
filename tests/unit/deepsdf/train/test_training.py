"""Training: it learns, it goes on after a kill as if nothing had been, and it keeps a budget."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import DeepSDF, local, published, train
from sdm.deepsdf.samples import ShapeSet
from sdm.deepsdf.train import checkpoint
from sdm.deepsdf.train import training as module
from sdm.deepsdf.train.batches import Batches
from sdm.errors import FormatError, SDMError
from sdm.shapes import Cochlea

SMALL: dict[str, Any] = {"width": 24, "points": 64, "shapes": 3}


@pytest.fixture(scope="module")
def shapes() -> ShapeSet:
    family = Cochlea(800)
    return ShapeSet([family.mesh(t) for t in family.sample(4, device="cpu")], "cpu")


def run(shapes: ShapeSet, folder: Path, **more: Any) -> dict[str, Any]:
    settings = more.pop("settings", None) or published(**SMALL, global_size=4, epochs=40)
    path = train(shapes, settings, folder, names=shapes.names, spheres=shapes.spheres, device="cpu", **more)
    return torch.load(path, weights_only=True)


def test_it_learns(shapes: ShapeSet, tmp_path: Path) -> None:
    settings = local(**SMALL, layers=2, grids=((4, 4),), epochs=150)
    saved = run(shapes, tmp_path, settings=settings)
    losses = [loss for _, _, loss in saved["history"]]
    assert losses[-1] < 0.3 * losses[0]
    model = DeepSDF.load(tmp_path, "cpu")
    assert model.names == shapes.names
    assert model.spheres == shapes.spheres
    points, values = shapes.sample(torch.tensor([2]), 2000, step=10**6)
    found = model.signed_distance(points[0], model.codes[2])
    assert (found - values[0]).abs().mean() < 0.5 * (points[0].norm(dim=1) - 0.5 - values[0]).abs().mean()


def test_a_training_that_was_killed_ends_with_the_same_weights(
    shapes: ShapeSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With dropout, whose random numbers have to be the same too."""
    whole = run(shapes, tmp_path / "whole")

    class Killed(Exception):
        pass

    update = module.Trainer.update

    def dies(self: module.Trainer, *args: Any) -> torch.Tensor:
        if self.step == 25:
            raise Killed
        return update(self, *args)

    monkeypatch.setattr(module.Trainer, "update", dies)
    with pytest.raises(Killed):
        run(shapes, tmp_path / "parts", checkpoint_every_s=0.0)
    assert not (tmp_path / "parts" / "model.pt").exists()
    monkeypatch.setattr(module.Trainer, "update", update)
    with pytest.raises(FormatError, match="keeps an unfinished training: --resume goes on with it; or remove it"):
        run(shapes, tmp_path / "parts")
    torch.manual_seed(99)
    parts = run(shapes, tmp_path / "parts", resume=True)
    assert parts["step"] == whole["step"] == 40
    assert all(torch.equal(whole["state"][name], parts["state"][name]) for name in whole["state"])


def test_a_finished_training_may_be_replaced_but_not_an_unfinished_one_beside_its_model(
    shapes: ShapeSet, tmp_path: Path
) -> None:
    first, second = run(shapes, tmp_path, budget_s=0.01), run(shapes, tmp_path, budget_s=0.01)
    assert first["seconds"] != second["seconds"]
    # What a third training leaves that is killed: its checkpoint beside the second's model.
    kept = torch.load(tmp_path / "checkpoint" / "model.pt", weights_only=True)
    checkpoint.write({**kept, "seconds": 123.0}, tmp_path / "checkpoint" / "model.pt")
    with pytest.raises(FormatError, match="keeps an unfinished training"):
        run(shapes, tmp_path, budget_s=0.01)


def test_nobody_elses_random_numbers_change(shapes: ShapeSet, tmp_path: Path) -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    run(shapes, tmp_path, budget_s=0.01)
    assert torch.equal(torch.rand(3), expected)


def test_a_budget_ends_it_and_no_second_is_spent_twice(shapes: ShapeSet, tmp_path: Path) -> None:
    settings = local(**SMALL, layers=2, grids=())
    first = run(shapes, tmp_path, settings=settings, budget_s=0.5)
    assert 0.5 <= first["seconds"] < 3
    again = run(shapes, tmp_path, settings=settings, budget_s=0.5, resume=True)
    assert again["step"] == first["step"]


def test_a_checkpoint_of_other_settings_or_shapes_is_refused(shapes: ShapeSet, tmp_path: Path) -> None:
    run(shapes, tmp_path, budget_s=0.01)
    with pytest.raises(FormatError, match="checkpoint of a training with other settings"):
        run(shapes, tmp_path, settings=published(**SMALL, global_size=4, epochs=41), resume=True)
    larger = [TriangleMesh(1.5 * shapes.mesh(n).vertices, shapes.mesh(n).faces, shapes.names[n]) for n in range(4)]
    with pytest.raises(FormatError, match="begun with other shapes"):
        run(ShapeSet(larger, "cpu"), tmp_path, resume=True)


def test_a_loss_that_is_not_finite_ends_it(shapes: ShapeSet, tmp_path: Path) -> None:
    settings = local(**SMALL, layers=2, grids=(), decoder_rate=1e30)
    with pytest.raises(SDMError, match="the loss is not finite at step"):
        run(shapes, tmp_path, settings=settings)


def test_every_epoch_sees_whole_batches_of_all_shapes_in_a_new_order() -> None:
    batches = Batches(10, 3, seed=1)
    assert batches.per_epoch == 3
    epochs = [torch.cat([batches[3 * e + i] for i in range(3)]).tolist() for e in range(4)]
    assert all(len(set(epoch)) == 9 for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) == 4


def test_ranks_share_a_batch() -> None:
    alone, shared = Batches(10, 5, seed=1), [Batches(10, 5, seed=1, rank=r, world=2) for r in range(2)]
    for step in range(6):
        parts = [b[step] for b in shared]
        assert {len(p) for p in parts} == {2}
        if step < 2:
            assert set(torch.cat(parts).tolist()) <= set(range(10))
    assert set(torch.cat([b[0] for b in shared]).tolist()) <= set(alone[0].tolist())
    with pytest.raises(SDMError, match="cannot be shared by 4 processes"):
        Batches(3, 64, seed=0, world=4)


def test_the_schedules() -> None:
    paper, ours = published(), local()
    assert [paper.rate_factor(d) for d in (0.0, 0.24, 0.25, 0.6, 0.99)] == [1, 1, 0.5, 0.25, 0.125]
    assert ours.rate_factor(0.0) < 0.1 < 0.9 < ours.rate_factor(0.03)
    assert ours.rate_factor(1.0) == pytest.approx(0.01)
    assert paper.code_weight_at(0.025) == pytest.approx(0.5e-4)
    assert paper.code_weight_at(0.5) == pytest.approx(1e-4)
