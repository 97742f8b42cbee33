from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt
from skimage.segmentation import find_boundaries

from sdm.errors import SDMError
from sdm.losses import foreground_distance, normalized_signed_distance, signed_distance_target
from sdm.losses.targets import inner_boundary


def blob(seed: int) -> np.ndarray:
    index = np.indices((13, 11, 9)) - np.array([6, 5, 4])[:, None, None, None]
    size = np.random.default_rng(seed).uniform(2, 4.5, 3)[:, None, None, None]
    return ((index / size) ** 2).sum(0) <= 1


def batch(*masks: np.ndarray) -> torch.Tensor:
    return torch.tensor(np.stack(masks))[:, None]


def published(mask: np.ndarray) -> np.ndarray:
    """The normalised map as the papers' text describes it, from SciPy and scikit-image."""
    inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
    scaled = outside / outside.max() - inside / inside.max()
    scaled[find_boundaries(mask, mode="inner")] = 0
    return scaled


def test_published_normalised_map():
    masks = [blob(0), blob(1), blob(2)]
    values = normalized_signed_distance(batch(*masks), surface="published")
    for value, mask in zip(values, masks, strict=True):
        np.testing.assert_allclose(value[0], published(mask), rtol=1e-6, atol=1e-7)


def test_normalised_by_hand():
    row = torch.tensor([0.0, 0, 0, 1, 1, 1]).reshape(1, 1, 6, 1, 1)
    faces = normalized_signed_distance(row).flatten()
    torch.testing.assert_close(faces, torch.tensor([1, 0.6, 0.2, -0.2, -0.6, -1]))


def test_published_signed_map():
    mask = blob(3)
    expected = distance_transform_edt(~mask) * ~mask - (distance_transform_edt(mask) - 1) * mask
    values = signed_distance_target(batch(mask), surface="published")[0, 0]
    np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-6)


def test_foreground_distance():
    mask = blob(4)
    expected = distance_transform_edt(mask, (1, 2, 3))
    np.testing.assert_allclose(foreground_distance(batch(mask), (1, 2, 3))[0, 0], expected, rtol=1e-6)
    scaled = foreground_distance(batch(mask), (1, 2, 3), normalized=True)[0, 0]
    np.testing.assert_allclose(scaled, expected / expected.max(), rtol=1e-6)


@pytest.mark.parametrize("surface", ["faces", "centres", "published"])
@pytest.mark.parametrize("value", [0, 1])
def test_empty_and_full(surface, value):
    mask = torch.full((2, 1, 3, 4, 5), value)
    assert not signed_distance_target(mask, surface=surface).any()
    assert not normalized_signed_distance(mask, surface=surface).any()
    assert not foreground_distance(mask).any()
    assert not foreground_distance(mask, normalized=True).any()


def test_an_empty_sample_beside_another():
    both = batch(np.zeros_like(blob(0)), blob(0))
    assert torch.equal(normalized_signed_distance(both)[1:], normalized_signed_distance(both[1:]))
    assert not normalized_signed_distance(both)[0].any()


def test_inner_boundary():
    mask = np.random.default_rng(0).random((7, 6, 5)) < 0.8
    assert np.array_equal(inner_boundary(batch(mask))[0, 0], find_boundaries(mask, connectivity=1, mode="inner"))
    with pytest.raises(SDMError, match="B,1,x,y,z"):
        inner_boundary(torch.zeros(3, 3, 3))


@pytest.mark.parametrize("surface", ["faces", "centres", "published"])
def test_one_label_has_one_scale(surface):
    one = torch.tensor(blob(0))
    with pytest.raises(SDMError, match=r"has no batch: give \(B,1,x,y,z\)"):
        normalized_signed_distance(one, surface=surface)
    with pytest.raises(SDMError, match="has no batch"):
        foreground_distance(one, normalized=True)
    assert torch.equal(foreground_distance(one), foreground_distance(one[None, None])[0, 0])
