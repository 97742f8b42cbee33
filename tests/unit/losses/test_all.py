"""Requirements of every loss: right gradients, finite on empty and full masks, no silent broadcasting."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from sdm import losses
from sdm.errors import SDMError

SHAPE = (2, 1, 4, 3, 5)
PROBABILITY = {
    "boundary": losses.boundary_loss,
    "boundary, published": partial(losses.boundary_loss, surface="published"),
    "hausdorff": partial(losses.hausdorff_distance_loss, spacing=(1.0, 2.0, 0.5)),
    "hausdorff, foreground": partial(losses.hausdorff_distance_loss, foreground_only=True),
    "dice": losses.dice_loss,
    "dice, squared": partial(losses.dice_loss, squared=True, per_sample=False),
}
LOGITS = {
    "cross-entropy": losses.cross_entropy_loss,
    "cross-entropy, weighted": partial(losses.cross_entropy_loss, weight=torch.tensor([1.0, 3.0])),
}


def of_sdf(loss, prediction, target, **options):
    return loss(prediction, losses.normalized_signed_distance(target).to(prediction.dtype), **options)


DISTANCE = {
    "product": partial(of_sdf, losses.sdf_product_loss),
    "product, voxels": partial(of_sdf, losses.sdf_product_loss, per_voxel=True),
    "weighted mse": partial(of_sdf, losses.inverse_weighted_mse_loss),
    "clamped l1": partial(of_sdf, losses.clamped_l1_loss, delta=0.4),
}
ALL = {**PROBABILITY, **LOGITS, **DISTANCE}


def inputs(name: str, dtype=torch.float64) -> tuple[torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(5)
    values = torch.rand(SHAPE, generator=random, dtype=torch.float64)
    if name not in PROBABILITY:
        values = 2 * values - 1
    return values.to(dtype).requires_grad_(), torch.rand(SHAPE, generator=random) < 0.4


@pytest.mark.parametrize("name", ALL)
def test_gradients(name):
    values, target = inputs(name)
    assert torch.autograd.gradcheck(lambda v: ALL[name](v, target), values)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("target", [0, 1])
@pytest.mark.parametrize("prediction", [0, 1])
def test_empty_and_full_masks(name, target, prediction):
    labels = torch.full(SHAPE, target).bool()
    values = torch.full(SHAPE, float(prediction))
    if name in LOGITS:
        values = 200 * (2 * values - 1)
    values.requires_grad_()
    loss = ALL[name](values, labels)
    loss.backward()
    assert loss.ndim == 0
    assert loss.isfinite()
    assert values.grad is not None
    assert values.grad.isfinite().all()
    assert name in DISTANCE or target != prediction or loss.abs() < 1e-5


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision(name, dtype):
    values, target = inputs(name, dtype)
    loss = ALL[name](values, target)
    assert loss.dtype == torch.float32
    loss.backward()
    assert values.grad is not None
    assert values.grad.isfinite().all()
    torch.testing.assert_close(loss, ALL[name](values.float(), target), rtol=2e-2, atol=2e-3)


@pytest.mark.parametrize("name", ALL)
def test_shapes_must_agree(name):
    values, target = inputs(name)
    with pytest.raises(SDMError, match="shape"):
        ALL[name](values, target[:1])


@pytest.mark.parametrize("name", ["boundary", "hausdorff", "dice"])
def test_integers_have_no_gradient(name):
    values, target = inputs(name)
    with pytest.raises(SDMError, match="floating"):
        ALL[name]((values > 0.5).long(), target)
