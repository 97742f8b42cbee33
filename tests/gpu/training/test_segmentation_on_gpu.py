"""Training and prediction on a GPU: every kind of method, in bfloat16, and on from a checkpoint."""

from __future__ import annotations

import pytest
import torch

from sdm.segmentation import METHODS, Patches, Settings, predict, train
from sdm.segmentation.infer.scores import scores_of
from tests.helpers.segmentation_cases import case

pytestmark = pytest.mark.gpu
SIZE = (32, 32, 32)


@pytest.mark.parametrize("method", ["baseline", "boundary", "hausdorff", "sdf-product", "branch-sdf-l1l2", "pwr"])
@pytest.mark.parametrize("architecture", ["vnet", "unet"])
def test_a_few_steps(method, architecture, tmp_path):
    settings = Settings(method=method, architecture=architecture, patch=SIZE, batch=2, steps=4, filters=4)
    patches = Patches([case(0), case(1)], METHODS[method].map, SIZE, "cuda")
    train(patches, settings, checkpoint=tmp_path / "c.pt", deadline=0.0)
    training = train(patches, settings, checkpoint=tmp_path / "c.pt")
    assert training.step == 4
    assert all(p.isfinite().all() for p in training.model.parameters())
    found = predict(training.model, case(2).image, SIZE)
    assert found.field.is_cuda
    assert found.field.isfinite().all()


def test_positions_are_told():
    settings = Settings(architecture="unet", patch=SIZE, batch=2, steps=4, filters=4, position=True)
    training = train(Patches([case(0), case(1)], None, SIZE, "cuda", position=True), settings)
    assert predict(training.model, case(2).image, SIZE, mirrors="x").field.isfinite().all()


def test_it_learns():
    settings = Settings(method="baseline", architecture="unet", patch=SIZE, batch=4, steps=80, filters=8)
    training = train(Patches([case(0), case(1)], None, SIZE, "cuda"), settings)
    truth = case(5)
    assert truth.label is not None
    found = predict(training.model, truth.image, SIZE)
    assert scores_of(found.label.cpu(), truth.label, truth.spacing)["dice"] > 0.7


@pytest.mark.parametrize("augment", ["none", "published", "affine", "strong", "scanner"])
def test_batches_wait_for_nothing(augment):
    patches = Patches([case(0), case(1)], "signed", SIZE, "cuda", position=True)
    patches.batch(2, seed=0, step=0, augment=augment)
    torch.cuda.set_sync_debug_mode("error")
    try:
        patches.batch(2, seed=0, step=1, augment=augment)
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_batches_are_those_of_the_cpu():
    there, here = (
        Patches([case(0), case(1)], "signed", SIZE, device, position=True).batch(3, seed=1, step=2, augment="published")
        for device in ("cuda", "cpu")
    )
    torch.testing.assert_close(there.image.cpu(), here.image, atol=1e-3, rtol=1e-3)
    assert (there.label.cpu() != here.label).float().mean() < 1e-3
