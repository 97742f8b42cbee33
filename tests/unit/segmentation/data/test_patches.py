"""Patches: copies where nothing turns, true distances where it does, the same whatever came before."""

from __future__ import annotations

import pytest
import torch

from sdm.segmentation import METHODS, Patches, distance_map
from sdm.segmentation.data.augment import draw
from sdm.segmentation.data.case import standardized
from sdm.segmentation.data.patches import _as_if_by_another_scanner, _noise
from tests.helpers.segmentation_cases import case

SIZE = (16, 8, 12)


def test_a_patch_that_is_not_turned_is_a_copy():
    cases = [case(0)]
    patches = Patches(cases, "signed", SIZE, "cpu")
    batch = patches.batch(3, seed=1, step=5, augment="none")
    image = standardized(cases[0].image)
    label = cases[0].label
    assert label is not None
    whole = distance_map(label[None, None], "signed", cases[0].spacing)[0, 0]
    for row in range(3):
        place = draw(1, 5, row, 1, "none").place
        corner = [int(p * (n - m + 1)) for p, n, m in zip(place.tolist(), image.shape, SIZE, strict=True)]
        box = tuple(slice(c, c + m) for c, m in zip(corner, SIZE, strict=True))
        torch.testing.assert_close(batch.image[row, 0], image[box], atol=1e-4, rtol=1e-4)
        assert torch.equal(batch.label[row, 0], label[box])
        assert batch.map is not None
        torch.testing.assert_close(batch.map[row, 0], whole[box], atol=1e-3, rtol=1e-4)


@pytest.mark.parametrize("augment", ["none", "published", "affine", "strong", "scanner"])
def test_a_batch_depends_on_seed_and_step_alone(augment):
    first, second = (Patches([case(0), case(1)], "signed", SIZE, "cpu") for _ in range(2))
    first.batch(2, seed=3, step=0, augment=augment)
    one, other = (p.batch(2, seed=3, step=7, augment=augment) for p in (first, second))
    assert torch.equal(one.image, other.image)
    assert torch.equal(one.label, other.label)
    for seed, step in ((3, 8), (4, 7)):
        assert not torch.equal(one.image, first.batch(2, seed=seed, step=step, augment=augment).image)


def test_published_patches_are_turned_copies():
    patches = Patches([case(0, spacing=(1.0, 1.0, 1.0))], None, (20, 20, 20), "cpu")
    whole = standardized(case(0).image)
    turned = patches.batch(4, seed=0, step=0, augment="published")
    for row in range(4):
        # Every voxel of a copy is somewhere in the case, whichever way it is turned.
        values = turned.image[row].flatten()[::50]
        nearest = (values[:, None] - whole.flatten()[None]).abs().amin(1)
        assert nearest.max() < 2e-3


def test_distances_of_scaled_and_turned_patches_are_true():
    """The map of the case, turned and scaled with it, is the transform of the turned label."""
    unit = (1.0, 1.0, 1.0)
    label = torch.zeros(48, 48, 48, dtype=torch.bool)
    index = torch.stack(torch.meshgrid(*[torch.arange(48.0) - 23.5] * 3, indexing="ij"))
    label |= (index / torch.tensor([12.0, 9.0, 7.0]).view(3, 1, 1, 1)).square().sum(0) < 1
    patches = Patches([case(0, image=label.float(), label=label, spacing=unit)], "signed", (48, 48, 48), "cpu")
    for step in range(4):
        batch = patches.batch(1, seed=0, step=step, augment="affine")
        assert batch.map is not None
        again = distance_map(batch.label, "signed", unit)
        inner = (slice(None), slice(None), *[slice(8, -8)] * 3)
        assert (batch.map - again)[inner].abs().max() < 1.2
        assert (batch.map - again)[inner].mean().abs() < 0.25


def test_patches_are_mirrored_along_some_axes_alone():
    def hands(mirrors):
        return {round(float(draw(0, s, 0, 2, "affine", mirrors=mirrors).turn.det())) for s in range(30)}

    assert hands("xyz") == hands("y") == {-1, 1}
    assert hands("") == {1}
    one, other = (Patches([case(0)], None, SIZE, "cpu", mirrors=m) for m in ("xyz", ""))
    assert any(
        not torch.equal(one.batch(1, seed=0, step=s).label, other.batch(1, seed=0, step=s).label) for s in (0, 1)
    )


@pytest.mark.parametrize("coarse", [False, True])
def test_noise_has_the_deviation_that_was_drawn(coarse):
    noise = _noise(torch.empty(2, 1, 41, 40, 39), torch.Generator().manual_seed(0), coarse=coarse)
    assert noise.shape == (2, 1, 41, 40, 39)
    assert noise.std() == pytest.approx(1.0, abs=0.05)
    neighbours = (noise[..., 1:] * noise[..., :-1]).mean()
    assert neighbours == pytest.approx(0.75 if coarse else 0.0, abs=0.05)


def test_small_cases_are_padded_by_background():
    small = case(0)
    batch = Patches([small], "clipped", (32, 32, 32), "cpu").batch(1, seed=0, step=0, augment="none")
    assert small.label is not None
    assert int(batch.label.sum()) == int(small.label.sum())
    assert batch.map is not None
    assert float(batch.map[0, 0, 0, 0, 0]) == pytest.approx(1.0)


def test_published_targets_are_those_of_the_patch():
    patches = Patches([case(0)], "normalized", SIZE, "cpu", per_patch=True)
    batch = patches.batch(2, seed=0, step=3)
    assert batch.map is not None
    assert torch.equal(batch.map, distance_map(batch.label, "normalized", published=True))


def test_every_method_has_its_map():
    for method in METHODS.values():
        batch = Patches([case(0)], method.map, SIZE, "cpu").batch(1, seed=0, step=0)
        assert (batch.map is None) == (method.map is None)


def test_another_scanner_changes_contrast_but_not_brightness():
    image = standardized(case(0).image)[None, None].repeat(2, 1, 1, 1, 1)
    drawn = torch.tensor([[1.5, 0.8], [0.6, 0.0]]).reshape(2, 2, 1, 1, 1, 1)
    flat = torch.ones(2, 1, 4, 4, 4)
    found = _as_if_by_another_scanner(image, drawn[0], flat, drawn[1])
    torch.testing.assert_close(found.mean((1, 2, 3, 4)), image.mean((1, 2, 3, 4)), atol=1e-4, rtol=0)
    torch.testing.assert_close(found.std((1, 2, 3, 4)), image.std((1, 2, 3, 4)), atol=1e-4, rtol=0)
    # Unblurred, an exponent keeps the order of the voxels; blurred it does not.
    order = image[0].flatten().argsort()
    unblurred = _as_if_by_another_scanner(image, drawn[0], flat, torch.zeros_like(drawn[1]))
    assert (unblurred[0].flatten()[order].diff() >= -1e-5).all()
    assert not (found[0].flatten()[order].diff() >= -1e-5).all()


def test_shading_is_smooth():
    image = torch.linspace(1, 2, 24).expand(1, 1, 24, 24, 24).clone()
    shade = torch.ones(1, 1, 4, 4, 4)
    shade[:, :, 0] = 2
    one = torch.ones(1, 1, 1, 1, 1)
    found = _as_if_by_another_scanner(image, one, shade, 0 * one)
    along = found[0, 0, :, 12, 12]
    assert along[0] > 1.2 * along[-1]
    assert along.diff().abs().max() < 0.3 * (along[0] - along[-1])
