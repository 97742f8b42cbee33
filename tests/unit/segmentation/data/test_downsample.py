"""Larger voxels: where they lie, what is known of the surface in them, and the way back."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import nn

from sdm.errors import SDMError
from sdm.segmentation import (
    Patches,
    SegmentationModel,
    Settings,
    TrainedModel,
    check_ensemble,
    distance_map,
    load_model,
    method_called,
    predict,
    predict_ensemble,
    save_model,
    train,
)
from sdm.segmentation.data.case import standardized
from sdm.segmentation.data.downsample import coarse_image, coarse_map, fine_field, whole_cubes
from tests.helpers.segmentation_cases import case

SHAPE = (13, 8, 10)
CUBE = (16, 16, 16)


def line(axis: int) -> torch.Tensor:
    """(x,y,z) values that are each voxel's index along an axis."""
    lines = torch.meshgrid(*[torch.arange(float(n)) for n in SHAPE], indexing="ij")
    return lines[axis].contiguous()


def settings(**changes) -> Settings:
    given = {"patch": CUBE, "batch": 2, "steps": 2, "filters": 2, "architecture": "unet", "coarsen": 2}
    return Settings(**{**given, **changes})


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
def test_cubes_are_counted_from_the_first_voxel(factor):
    image = torch.randn(SHAPE)
    found = coarse_image(image, factor)
    assert found.shape == tuple(-(-n // factor) for n in SHAPE)
    for cube in [(0, 0, 0), (1, 1, 1), (2, 0, 1)]:
        box = tuple(slice(factor * c, factor * c + factor) for c in cube)
        torch.testing.assert_close(found[cube], image[box].mean())
    assert torch.equal(whole_cubes(image, factor)[tuple(slice(n) for n in SHAPE)], image)


@pytest.mark.parametrize("factor", [2, 3, 4])
@pytest.mark.parametrize("axis", range(3))
def test_the_way_back_is_the_way_there(factor, axis):
    """A linear field comes back as it was but for half a cube at the ends: nothing is moved."""
    fine = line(axis)
    for coarse in (coarse_image(fine, factor), coarse_map(fine, factor)):
        back = fine_field(coarse, factor, fine.shape)
        assert back.shape == fine.shape
        inner = tuple(slice(factor, n // factor * factor - factor) for n in SHAPE)
        torch.testing.assert_close(back[inner], fine[inner], atol=1e-5, rtol=0)


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_a_map_knows_where_the_surface_is_between_coarse_voxels(factor):
    """At the cubes' centres, of a half space that ends inside a cube."""
    label = torch.zeros(24, 24, 24, dtype=torch.bool)
    label[:11] = True
    fine = distance_map(label[None, None], "signed")[0, 0]
    found = coarse_map(fine, factor)[:, 3, 3]
    centres = factor * torch.arange(len(found)) + (factor - 1) / 2
    torch.testing.assert_close(found, centres - 10.5, atol=1e-5, rtol=0)


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_patches_of_larger_voxels(factor):
    one = case(0)
    patches = Patches([one], "signed", (8, 8, 8), "cpu", coarsen=factor)
    assert patches.spacing == tuple(factor * s for s in one.spacing)
    batch = patches.batch(1, seed=0, step=0, augment="none")
    # The same place by hand: the whole case in one patch.
    shape = tuple(-(-n // factor) for n in one.image.shape)
    whole = Patches([one], "signed", shape, "cpu", coarsen=factor).batch(1, seed=0, step=0, augment="none")
    torch.testing.assert_close(whole.image[0, 0], standardized(coarse_image(one.image, factor)), atol=1e-4, rtol=1e-4)
    assert one.label is not None
    share = coarse_image(one.label.float(), factor)
    # Half of a cube is either.
    clear = (share - 0.5).abs() > 1e-3
    assert torch.equal(whole.label[0, 0][clear], share[clear] > 0.5)
    assert whole.map is not None
    inner = tuple(slice(1, n - 1) for n in shape)
    exact = coarse_map(distance_map(one.label[None, None], "signed", one.spacing)[0, 0], factor)
    torch.testing.assert_close(whole.map[0, 0][inner], exact[inner], atol=1e-3, rtol=1e-3)
    assert batch.image.shape == (1, 1, 8, 8, 8)


def test_clipped_maps_count_larger_voxels():
    one = case(0)
    batch = Patches([one], "clipped", (16, 16, 16), "cpu", coarsen=2).batch(1, seed=0, step=0, augment="none")
    signed = Patches([one], "signed", (16, 16, 16), "cpu", coarsen=2).batch(1, seed=0, step=0, augment="none")
    assert batch.map is not None
    assert signed.map is not None
    far = 5 * 2 * max(one.spacing)
    torch.testing.assert_close(batch.map, signed.map.clamp(-far, far) / far, atol=1e-6, rtol=0)


class Seen(nn.Module):
    """Says what it sees."""

    position = False
    coarsen = 2

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(()))

    def field(self, image):
        return self.weight * image


def test_a_network_sees_all_of_a_volume_in_one_window_and_its_field_is_enlarged():
    image = line(0)
    found = predict(Seen(), image, (8, 4, 5)).field  # pyright: ignore[reportArgumentType]
    assert found.shape == image.shape
    inner = (slice(2, 10), slice(None), slice(None))
    # Standardised, so a line still.
    slope = found[inner].diff(dim=0)
    torch.testing.assert_close(slope, slope.mean().expand_as(slope), atol=1e-5, rtol=0)


def test_what_was_trained_on_larger_voxels_is_used_on_them(tmp_path):
    cases = [case(0), case(1)]
    own = settings()
    training = train(Patches.of_settings(cases, own, "cpu"), own)
    trained = TrainedModel(training.model, own, cases[0].spacing)
    save_model(trained, tmp_path / "model.pt")
    again = load_model(tmp_path / "model.pt")
    assert again.settings.coarsen == again.model.coarsen == 2
    first, second = (predict(one.model, cases[0].image, CUBE) for one in (trained, again))
    assert first.field.shape == cases[0].image.shape
    assert torch.equal(first.field, second.field)


def test_patches_and_settings_must_agree():
    patches = Patches.of_settings([case(0)], settings(), "cpu")
    with pytest.raises(SDMError, match="coarsen=1, the patches 2"):
        train(patches, settings(coarsen=1))
    with pytest.raises(SDMError, match="whole number, 1 or more, not by 0"):
        settings(coarsen=0)


def test_networks_of_both_kinds_have_a_mean():
    """Probabilities have, whatever the voxels; distances that are clipped at so many voxels have not."""
    one, other = (
        TrainedModel(settings(coarsen=n).network().eval(), settings(coarsen=n), case(0).spacing) for n in (1, 2)
    )
    image = case(0).image
    mean = predict_ensemble([one, other], image).field
    parts = [predict(m.model, image, CUBE).field for m in (one, other)]
    torch.testing.assert_close(mean, (parts[0] + parts[1]) / 2, atol=1e-5, rtol=0)

    def clipped(n):
        own = settings(coarsen=n, method="pwr")
        return TrainedModel(own.network(), own, case(0).spacing)

    check_ensemble([clipped(2), clipped(2)])
    with pytest.raises(SDMError, match="2 times as large"):
        check_ensemble([clipped(1), clipped(2)])


def test_a_record_of_before_has_voxels_as_they_are():
    record = settings(coarsen=1).record()
    del record["coarsen"]
    assert Settings.of_record(record).coarsen == 1
    assert SegmentationModel(method_called("baseline"), filters=2).coarsen == 1
    assert replace(settings(), coarsen=3).network().coarsen == 3
