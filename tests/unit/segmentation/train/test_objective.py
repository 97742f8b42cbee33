"""Every method's loss: hand-made values of the mixtures, finite on empty and full labels."""

from __future__ import annotations

import math

import pytest
import torch

from sdm.losses import boundary_loss, cross_entropy_loss, dice_loss, hausdorff_distance_loss
from sdm.segmentation import MA_ROWS, METHODS, distance_map, method_called
from sdm.segmentation.train.objective import Step, objective


def step(name, main, label, done=0.0):
    kind = METHODS[name].map
    return Step(METHODS[name], main, label, None if kind is None else distance_map(label, kind), done)


def tensors():
    random = torch.Generator().manual_seed(3)
    label = torch.zeros(2, 1, 6, 5, 7, dtype=torch.bool)
    label[:, :, 1:4, 1:4, 2:6] = True
    return torch.randn(label.shape, generator=random), label


def test_the_sixteen_rows():
    assert MA_ROWS[:4] == ("baseline", "boundary", "hausdorff", "sdf-product")
    assert len(MA_ROWS) == 16
    rows = {(m.auxiliary, m.map, m.distance) for m in (METHODS[n] for n in MA_ROWS[4:])}
    assert len(rows) == 12


def test_baseline_by_hand():
    """Logit 0 everywhere and half of the voxels foreground: cross-entropy ln 2, Dice 1/2."""
    label = torch.zeros(1, 1, 4, 4, 4, dtype=torch.bool)
    label[..., :2] = True
    loss = objective(step("baseline", torch.zeros(label.shape), label), None)
    assert float(loss) == pytest.approx(0.5 * (math.log(2) + 0.5), abs=1e-5)


@pytest.mark.parametrize("name", ["boundary", "hausdorff", "hausdorff-foreground"])
def test_the_region_loss_gives_way(name):
    main, label = tensors()
    chance = main.sigmoid()
    region = cross_entropy_loss(main, label) + dice_loss(chance, label)
    if name == "boundary":
        other = boundary_loss(chance, label)
    else:
        other = hausdorff_distance_loss(chance, label, foreground_only=name != "hausdorff")
    for done, alpha in ((0.0, 1.0), (0.5, 0.505), (1.0, 0.01)):
        loss = objective(step(name, main, label, done), None)
        torch.testing.assert_close(loss, alpha * region + (1 - alpha) * other)


@pytest.mark.parametrize(("distance", "expected"), [("l1", 0.5), ("l2", 0.25), ("l1l2", 0.75)])
def test_auxiliary_losses(distance, expected):
    main, label = tensors()
    state = step(f"head-sdf-{distance}", main, label)
    region = cross_entropy_loss(main, label) + dice_loss(main.sigmoid(), label)
    assert state.map is not None
    torch.testing.assert_close(objective(state, state.map + 0.5), region + expected)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("value", [0, 1])
def test_empty_and_full_labels(name, value):
    main, _ = tensors()
    main = (main.tanh() if METHODS[name].output == "tanh" else main).requires_grad_()
    label = torch.full(main.shape, bool(value))
    state = step(name, main, label, done=0.5)
    loss = objective(state, None if METHODS[name].auxiliary is None else main.sigmoid())
    loss.backward()
    assert loss.isfinite()
    assert main.grad is not None
    assert main.grad.isfinite().all()


def test_maps_of_a_slab():
    """Four of eight layers inside: depths 0.5 to 3.5 behind one face; the other is the volume's border."""
    label = torch.zeros(1, 1, 8, 3, 3, dtype=torch.bool)
    label[:, :, 4:] = True
    signed = distance_map(label, "signed", (2.0, 2.0, 2.0))[0, 0, :, 1, 1]
    assert signed.tolist() == [7, 5, 3, 1, -1, -3, -5, -7]
    assert distance_map(label, "normalized")[0, 0, :, 1, 1].tolist() == pytest.approx([s / 7 for s in signed.tolist()])
    assert distance_map(label, "foreground")[0, 0, :, 1, 1].tolist() == [0, 0, 0, 0, 0.25, 0.5, 0.75, 1]
    assert distance_map(label, "clipped", (2.0, 2.0, 2.0))[0, 0, :, 1, 1].tolist() == pytest.approx(
        [s / 10 for s in signed.tolist()]
    )


def test_unknown_methods_are_refused():
    from sdm.errors import SDMError

    with pytest.raises(SDMError, match="head-sdf-l1"):
        method_called("best")
