"""Synthetic cases: image, label and map belong together, and are a function of seed and step."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.segmentation import Patches, SyntheticPatches, distance_map
from sdm.segmentation.data.shape_warps import warped
from sdm.segmentation.train.methods import Map
from tests.helpers.segmentation_cases import case, volume

SIZE = (16, 16, 16)
UNIT = {"spacing": (1.0, 1.0, 1.0)}


def labels(*seeds: int) -> list[torch.Tensor]:
    return [torch.from_numpy(volume(seed)[1] != 0) for seed in seeds]


def synthetic(kind: Map = "signed", **options) -> SyntheticPatches:
    given = {"shapes": labels(7, 8), "share": 1.0, **options}
    return SyntheticPatches([case(0, **UNIT), case(1, **UNIT)], kind, SIZE, "cpu", **given)


def test_a_case_that_is_not_warped_is_itself():
    patches = synthetic()
    u = torch.zeros_like(patches._warp(0, 0))
    image, within, values = patches.synthetic(0, u)
    own = patches._cases[0]
    torch.testing.assert_close(image, own[0], atol=1e-4, rtol=1e-4)
    assert ((within > 0.5) != (own[1] > 0.5)).float().mean() < 0.002
    # The surface is between the voxels, the label's own distances are from their faces.
    assert (values - own[2]).abs().max() < 0.6


@pytest.mark.parametrize("kind", ["signed", "normalized", "foreground"])
def test_the_map_is_that_of_the_warped_label_and_the_image_shows_it(kind):
    patches = synthetic(kind)
    channels = patches.synthetic(0, patches._warp(0, 0))
    label = channels[1] > 0.5
    assert 2 * (label & (patches._cases[0][1] > 0.5)).sum() / (label.sum() + (patches._cases[0][1] > 0.5).sum()) < 0.95
    wanted = distance_map(label[None, None], kind, (1.0, 1.0, 1.0))[0, 0]
    limit = {"signed": 1.2, "normalized": 0.2, "foreground": 0.25}[kind]
    assert (channels[2] - wanted).abs().max() < limit
    # The organ is brighter by three deviations of the noise and more.
    assert channels[0][label].mean() > channels[0][~label].mean() + 1


def test_a_case_meets_the_shape():
    patches = synthetic()
    # These cases are small: displacements of all voxels, not of larger ones.
    patches._factor = 1
    moving, fixed = patches._coarse(0, patches._own[0]), patches._coarse(0, patches._shapes_only[0])
    after = warped(moving[None], patches._warp(0, 0).float())[0]
    near = fixed.abs() < 1.5
    assert (after - fixed)[near].abs().mean() < 0.5 * (moving - fixed)[near].abs().mean()


def test_brightness_of_another_case():
    patches = synthetic()
    u = torch.zeros_like(patches._warp(0, 0))
    patches._brightness[1, 0] = patches._brightness[0, 0] + 2
    image = patches.synthetic(0, u, as_case=1, mix=1.0)[0]
    change = image - patches._cases[0][0]
    inside = patches._cases[0][2] < -1
    assert abs(float(change[inside].mean()) - 2) < 0.1
    assert change[patches._cases[0][2] > 1].abs().max() < 1e-3


@pytest.mark.parametrize("augment", ["none", "strong"])
def test_a_batch_depends_on_seed_and_step_alone(augment):
    first, second = synthetic(), synthetic()
    first.batch(1, seed=3, step=0, augment=augment)
    one, other = (p.batch(2, seed=3, step=7, augment=augment) for p in (first, second))
    assert torch.equal(one.image, other.image)
    assert torch.equal(one.label, other.label)
    assert one.map is not None
    assert other.map is not None
    assert torch.equal(one.map, other.map)
    assert not torch.equal(one.image, first.batch(2, seed=3, step=8, augment=augment).image)


def test_none_of_them_is_the_patches_of_the_cases():
    plain = Patches([case(0, **UNIT), case(1, **UNIT)], "signed", SIZE, "cpu").batch(2, seed=1, step=2)
    assert torch.equal(synthetic(share=0.0).batch(2, seed=1, step=2).image, plain.image)


def test_larger_voxels():
    batch = synthetic(coarsen=2).batch(1, seed=0, step=0)
    assert batch.image.shape == (1, 1, *SIZE)
    assert bool(batch.label.any())


def test_shapes_that_cannot_be_used():
    with pytest.raises(SDMError, match="need shapes"):
        synthetic(shapes=[])
    with pytest.raises(SDMError, match="shape 0 has no foreground"):
        synthetic(shapes=[torch.zeros(8, 8, 8, dtype=torch.bool)])
