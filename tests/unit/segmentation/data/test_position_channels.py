"""Positions: those of the tissue, in patches and windows, whichever way they are cut, turned or mirrored."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from sdm.errors import FormatError, SDMError
from sdm.segmentation import (
    METHODS,
    Patches,
    SegmentationModel,
    Settings,
    TrainedModel,
    load_model,
    predict,
    save_model,
    sliding_window,
    train,
)
from sdm.segmentation.data.augment import draw
from sdm.segmentation.data.case import standardized
from tests.helpers.segmentation_cases import case

SIZE = (16, 8, 12)
CUBE = (16, 16, 16)


def whole(shape) -> torch.Tensor:
    """(3,*shape): of every voxel of a volume."""
    lines = [2 * (torch.arange(n, dtype=torch.float64) + 0.5) / n - 1 for n in shape]
    return torch.stack(torch.meshgrid(*lines, indexing="ij")).float()


def test_a_patch_has_the_positions_of_its_place():
    cases = [case(0)]
    batch = Patches(cases, None, SIZE, "cpu", position=True).batch(3, seed=1, step=5, augment="none")
    plain = Patches(cases, None, SIZE, "cpu").batch(3, seed=1, step=5, augment="none")
    assert batch.image.shape == (3, 4, *SIZE)
    assert torch.equal(batch.image[:, :1], plain.image)
    expected = whole(cases[0].image.shape)
    for row in range(3):
        place = draw(1, 5, row, 1, "none").place
        corner = [int(p * (n - m + 1)) for p, n, m in zip(place.tolist(), cases[0].image.shape, SIZE, strict=True)]
        box = tuple(slice(c, c + m) for c, m in zip(corner, SIZE, strict=True))
        torch.testing.assert_close(batch.image[row, 1:], expected[:, *box], atol=1e-6, rtol=0)


@pytest.mark.parametrize("augment", ["none", "published", "affine", "strong", "scanner"])
def test_positions_go_with_the_tissue(monkeypatch, augment):
    """An image that is its own position along an axis: however patches are turned, both channels stay the same."""
    monkeypatch.setattr(Patches, "_intensities", lambda self, image, *_: image)
    truth = whole(case(0).image.shape)
    for axis in range(3):
        shown = standardized(truth[axis])
        patches = Patches([case(0, image=truth[axis])], None, SIZE, "cpu", position=True)
        for step in range(4):
            image, positions = patches.batch(2, seed=0, step=step, augment=augment).image.split([1, 3], 1)
            # Beyond the outermost centres an image repeats them, while positions go on.
            last = [1 - 1 / n for n in truth.shape[1:]]
            inside = torch.stack([positions[:, a].abs() <= last[a] for a in range(3)]).all(0)
            assert inside.float().mean() > 0.5
            expected = (positions[:, axis] - truth[axis].mean()) / truth[axis].std()
            torch.testing.assert_close(image[:, 0][inside], expected[inside], atol=1e-4, rtol=0)
            assert image.abs().max() <= shown.abs().max() + 1e-4


def test_what_pads_a_small_case_lies_beyond_it():
    small = case(0)
    batch = Patches([small], None, (32, 32, 32), "cpu", position=True).batch(1, seed=0, step=0, augment="none")
    corner = [(32 - n) // 2 for n in small.image.shape]
    box = tuple(slice(c, c + n) for c, n in zip(corner, small.image.shape, strict=True))
    found = batch.image[0, 1:]
    torch.testing.assert_close(found[:, *box], whole(small.image.shape), atol=1e-6, rtol=0)
    assert (found[:, 0, 0, 0] < -1).all()
    assert (found[:, -1, -1, -1] > 1).all()


@pytest.mark.parametrize("shape", [(20, 17, 9), (8, 8, 8), (5, 20, 6)])
@pytest.mark.parametrize("stride", [None, (3, 5, 8)])
def test_windows_have_the_positions_of_the_volume(shape, stride):
    seen = []

    def field(windows, axis):
        seen.append(windows.shape[1:])
        return windows[:, 1 + axis, None]

    for axis in range(3):
        found = sliding_window(
            lambda x, axis=axis: field(x, axis), torch.randn(shape), (8, 8, 8), stride=stride, batch=3, position=True
        )
        torch.testing.assert_close(found, whole(shape)[axis], atol=1e-5, rtol=0)
    assert set(seen) == {(4, 8, 8, 8)}


class Told(nn.Module):
    """Says the position along one axis, looking at it as a network would: voxel by voxel."""

    position = True
    coarsen = 1

    def __init__(self, axis: int) -> None:
        super().__init__()
        self.axis = axis
        self.weight = nn.Parameter(torch.ones(()))

    def field(self, image):
        return self.weight * image[:, 1 + self.axis, None]


@pytest.mark.parametrize("axis", range(3))
def test_mirror_images_keep_the_positions_of_the_tissue(axis):
    """Turned back, what was said of a voxel's position is the same in every mirror image."""
    found = predict(Told(axis), torch.randn(20, 17, 9), (8, 8, 8), mirrors="xyz").field  # pyright: ignore[reportArgumentType]
    torch.testing.assert_close(found, whole((20, 17, 9))[axis], atol=1e-5, rtol=0)


def settings(**changes):
    given = {"patch": CUBE, "batch": 2, "steps": 3, "filters": 2, "architecture": "unet", "position": True}
    return Settings(**{**given, **changes})


def patches(position=True):
    return Patches([case(0), case(1)], None, CUBE, "cpu", position=position)


@pytest.mark.parametrize("architecture", ["unet", "vnet"])
def test_networks_that_are_told_positions(architecture, tmp_path):
    chosen = settings(architecture=architecture)
    training = train(patches(), chosen)
    save_model(TrainedModel(training.model, chosen, (1.0, 1.0, 1.0)), tmp_path / "model.pt")
    again = load_model(tmp_path / "model.pt")
    assert again.settings.position
    assert again.model.encoder.levels[0][0].weight.shape[1] == 4
    found, same = (predict(m, case(2).image, CUBE).field for m in (training.model, again.model))
    assert torch.equal(found, same)
    # The same tissue elsewhere is another input.
    moved = predict(again.model, torch.nn.functional.pad(case(2).image, (0, 0, 0, 0, 9, 0)), CUBE).field
    assert not torch.allclose(found, moved[9:], atol=1e-3)


def test_networks_of_before_positions_load(tmp_path):
    chosen = settings(position=False)
    model = SegmentationModel(METHODS["baseline"], "unet", filters=2)
    save_model(TrainedModel(model, chosen, (1.0, 1.0, 1.0)), tmp_path / "model.pt")
    state = torch.load(tmp_path / "model.pt", weights_only=True)
    del state["settings"]["position"]
    torch.save(state, tmp_path / "model.pt")
    again = load_model(tmp_path / "model.pt")
    assert again.settings == chosen
    assert again.model.encoder.levels[0][0].weight.shape[1] == 1
    assert predict(again.model, case(2).image, CUBE).field.shape == case(2).image.shape


def test_checkpoints_of_before_positions_go_on(tmp_path):
    path = tmp_path / "c.pt"
    train(patches(False), settings(position=False), checkpoint=path, deadline=0.0)
    state = torch.load(path, weights_only=True)
    del state["settings"]["position"]
    torch.save(state, path)
    assert train(patches(False), settings(position=False), checkpoint=path).step == 3


@pytest.mark.parametrize("position", [False, True])
def test_a_training_does_not_go_on_with_the_other_choice(tmp_path, position):
    path = tmp_path / "c.pt"
    train(patches(position), settings(position=position), checkpoint=path, deadline=0.0)
    with pytest.raises(FormatError, match="other settings: give those, or another file"):
        train(patches(not position), settings(position=not position), checkpoint=path)


def test_patches_and_settings_must_agree():
    with pytest.raises(SDMError, match="give both the same"):
        train(patches(False), settings())
