"""DeepSDF's samples on a GPU: right, never waited for, and the same beside a training as in line with it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from sdm.deepsdf import local
from sdm.deepsdf.samples import ShapeSet
from sdm.deepsdf.train.training import Trainer
from sdm.shapes import Cochlea

pytestmark = pytest.mark.gpu


@pytest.fixture(scope="module")
def shapes() -> dict[str, ShapeSet]:
    family = Cochlea(2_000)
    meshes = [family.mesh(theta) for theta in family.sample(9, device="cpu")]
    return {device: ShapeSet(meshes, device) for device in ("cpu", "cuda")}


def test_samples_are_those_of_the_cpu(shapes):
    """Sines and logarithms differ by roundings, so the points do; the values belong to the points."""
    chosen = torch.tensor([4, 0, 8])
    there = shapes["cuda"].sample(chosen.cuda(), 5_000, seed=3, step=2)
    here = shapes["cpu"].sample(chosen, 5_000, seed=3, step=2)
    # Where the place along the areas is within rounding of a face's end, either face will do.
    apart = (there.points.cpu() - here.points).abs().amax(-1) > 1e-5
    assert apart.float().mean() < 1e-3
    exact = shapes["cpu"].signed_distance(chosen, there.points.cpu())
    assert (there.values.cpu() - exact).abs().max() < 1e-6


def test_never_waits_for_the_device(shapes):
    chosen = torch.arange(9, device="cuda")
    expected = shapes["cuda"].sample(chosen, 2_000, step=7)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        found = shapes["cuda"].sample(chosen, 2_000, step=7)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert torch.equal(found.points, expected.points)
    assert torch.equal(found.values, expected.values)


def test_drawn_beside_the_training_they_are_the_same(shapes, tmp_path: Path):
    settings = local(width=32, layers=2, grids=((4, 4),), points=4_096, shapes=4, epochs=20)
    source = shapes["cuda"]
    trainer = Trainer(source, settings, tmp_path, names=source.names, spheres=source.spheres, device="cuda")
    trainer.prepare(False)
    steps = 30
    expected = [tuple(part.clone() for part in trainer.draw(step)) for step in range(steps)]
    batches = trainer.batches_ahead()
    for step in range(steps):
        batch = next(batches)
        for part, wanted in zip(batch, expected[step], strict=True):
            assert torch.equal(part, wanted)
        trainer.update(*batch)
        trainer.step += 1
