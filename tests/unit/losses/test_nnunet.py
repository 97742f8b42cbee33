"""Distance maps for batchgeneratorsv2, and nnU-Net's trainer with the boundary loss, where these are installed."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import sdm
from sdm.losses import boundary_loss, class_maps
from sdm.nnunet.with_boundary import WithBoundaryTerm
from tests.unit.losses.test_class_maps import LABELS, SPACING


class Nothing(torch.nn.Module):
    """A loss that is zero."""

    def forward(self, output, target):
        return torch.zeros(())


def logits(channels: int, shape=LABELS.shape[1:]) -> torch.Tensor:
    made = torch.randn(2, channels, *shape, generator=torch.Generator().manual_seed(0))
    return made.requires_grad_()


def test_boundary_of_labels():
    target = torch.stack([LABELS, LABELS.flip(1)]).float()
    output = logits(4)
    found = WithBoundaryTerm(Nothing(), [1, 2, 3], SPACING, weight=0.5)([output], [target])
    maps = torch.stack([class_maps(one, SPACING, classes=[1, 2, 3]) for one in target])
    wanted = (torch.softmax(output, 1)[:, 1:] * maps).mean()
    torch.testing.assert_close(found, 0.5 * wanted)
    found.backward()
    assert output.grad.abs().max() > 0


def test_boundary_of_regions_and_layers():
    masks = torch.stack([LABELS[0] > 0, LABELS[0] == 2]).repeat(2, 1, 1, 1, 1).float()
    output = logits(2)
    found = WithBoundaryTerm(Nothing(), None, SPACING, weight=1.0)(output, masks)
    wanted = boundary_loss(
        torch.sigmoid(output).reshape(4, 1, *LABELS.shape[1:]), masks.reshape(4, 1, 12, 10, 9), SPACING
    )
    torch.testing.assert_close(found, wanted)
    flat = WithBoundaryTerm(Nothing(), None, SPACING[1:], weight=1.0)(output[:, :, 5], masks[:, :, 5])
    assert torch.isfinite(flat)


def test_voxels_without_a_label_do_not_count():
    target = torch.stack([LABELS, LABELS]).clone()
    target[:, :, :4] = 9
    output = logits(4)
    WithBoundaryTerm(Nothing(), [1, 2, 3], SPACING, ignore=9)(output, target).backward()
    assert (output.grad[:, :, :4] == 0).all()
    assert (output.grad[:, :, 4:] != 0).any()


def test_distance_cut():
    term = WithBoundaryTerm(Nothing(), [1], SPACING, truncate=0.5)
    assert term._maps(LABELS[None]).abs().max() == 0.5


def test_batchgenerators():
    pytest.importorskip("batchgeneratorsv2", reason="needs batchgeneratorsv2")
    from batchgeneratorsv2.transforms.spatial.mirroring import MirrorTransform
    from batchgeneratorsv2.transforms.utils.compose import ComposeTransforms

    from sdm.nnunet import SignedDistanceTarget

    wanted = class_maps(LABELS, SPACING, classes=[1, 3])
    transform = SignedDistanceTarget([1, 3], spacing=SPACING)
    sample = {"image": torch.zeros(1, *LABELS.shape[1:]), "segmentation": LABELS.clone()}
    assert torch.equal(transform(**sample)["regression_target"], wanted)
    both = ComposeTransforms([MirrorTransform((0, 1, 2)), SignedDistanceTarget([1, 3], spacing=SPACING)])
    turned = both(**sample)
    again = class_maps(turned["segmentation"], SPACING, classes=[1, 3])
    assert torch.equal(turned["regression_target"], again)
    flat = SignedDistanceTarget([1, 3], spacing=SPACING[1:])(segmentation=LABELS[:, 5])["regression_target"]
    assert flat.shape == (2, 10, 9)
    # The nearest voxel may lie in another layer of the volume.
    assert (flat.abs() >= wanted[:, 5].abs() - 1e-6)[flat > 0].all()
    before = transform(segmentation=LABELS, regression_target=torch.ones(1, 12, 10, 9))["regression_target"]
    assert before.shape == (3, 12, 10, 9)
    assert torch.equal(before[1:], wanted)


def test_nnunet(monkeypatch):
    pytest.importorskip("nnunetv2", reason="needs nnU-Net")
    from nnunetv2.utilities.find_objects import recursive_find_trainer_class_by_name

    from sdm.nnunet import TRAINERS

    monkeypatch.setenv("nnUNet_extTrainer", TRAINERS)
    with warnings.catch_warnings():
        # nnU-Net and what it brings along warn as they load.
        warnings.simplefilter("ignore")
        try:
            trainer_class = recursive_find_trainer_class_by_name("nnUNetTrainerBoundary")
        except RuntimeError as error:
            if "torchvision" not in str(error):
                raise
            pytest.skip(f"torchvision is for CUDA, torch for the CPU: {error}")
    trainer = trainer_class.__new__(trainer_class)
    trainer.label_manager = SimpleNamespace(has_regions=False, foreground_labels=[1, 2, 3], ignore_label=None)
    trainer.configuration_manager = SimpleNamespace(batch_dice=False, spacing=SPACING)
    trainer.is_ddp, trainer.enable_deep_supervision = False, True
    trainer._do_i_compile = lambda: False
    trainer._get_deep_supervision_scales = lambda: [[1.0] * 3, [0.5] * 3]
    trainer.loss = trainer._build_loss()
    target = torch.stack([LABELS, LABELS]).float()
    output = logits(4)
    coarse = torch.nn.functional.interpolate(output, scale_factor=0.5), target[:, :, ::2, ::2, ::2][:, :, :6, :5, :4]
    value = trainer.loss([output, coarse[0]], [target, coarse[1]])
    plain = trainer.loss.loss([output, coarse[0]], [target, coarse[1]])
    torch.testing.assert_close(value - plain, 0.01 * trainer.loss.boundary(output, target))
    value.backward()
    trainer.current_epoch = 4
    monkeypatch.setattr(trainer_class.__mro__[1], "on_train_epoch_start", lambda self: None)
    trainer.on_train_epoch_start()
    np.testing.assert_allclose(trainer.loss.weight, 0.05)


@pytest.mark.parametrize(
    ("name", "needed"), [("SignedDistanceTarget", "batchgeneratorsv2"), ("nnUNetTrainerBoundary", "nnunetv2")]
)
def test_a_library_that_is_not_there_is_named(name, needed, monkeypatch):
    import sys

    for module in [module for module in sys.modules if module.startswith((needed, "sdm.nnunet"))]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, needed, None)
    with pytest.raises(sdm.SDMError, match=f"this needs {needed}, which cannot be imported"):
        getattr(__import__("sdm.nnunet", fromlist=[name]), name)
