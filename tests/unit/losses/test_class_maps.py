"""Distance maps of classes as targets: finite, cut and scaled."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.losses import class_maps

LABELS = torch.zeros(1, 12, 10, 9, dtype=torch.uint8)
LABELS[0, 2:6, 3:8, 2:7], LABELS[0, 7:11, 2:6, 3:6] = 1, 3
SPACING = (1.0, 0.5, 2.0)


def test_classes_and_masks():
    wanted = sdm.euclidean_distance_transform(LABELS[0], SPACING, classes=[1, 3], signed=True, surface="faces")
    assert torch.equal(class_maps(LABELS, SPACING, classes=[1, 3]), wanted)
    assert torch.equal(class_maps(LABELS[0], SPACING, classes="all"), wanted)
    masks = torch.cat([LABELS == 1, LABELS == 3])
    assert torch.equal(class_maps(masks, SPACING), wanted)
    assert class_maps(LABELS, SPACING).shape == (1, 12, 10, 9)


def test_cut_and_scaled():
    maps = class_maps(LABELS, SPACING, classes=[1, 2], truncate=0.5)
    assert (float(maps[0].min()), float(maps[0].max())) == (-0.5, 0.5)
    # A class that is not there is far everywhere.
    assert maps[1].eq(0.5).all()
    assert torch.equal(class_maps(LABELS, SPACING, classes=[1, 2], truncate=0.5, normalize=True), maps / 0.5)
    scaled = class_maps(LABELS, SPACING, classes=[1, 2, 3], normalize=True)
    assert scaled[[0, 2]].flatten(1).amin(1).eq(-1).all()
    assert scaled[[0, 2]].flatten(1).amax(1).eq(1).all()
    assert scaled[1].eq(0).all()


def test_what_is_refused():
    with pytest.raises(sdm.GridError, match="are no sample"):
        class_maps(LABELS[None])
    with pytest.raises(sdm.SDMError, match="2 channels are masks"):
        class_maps(LABELS.repeat(2, 1, 1, 1), classes=2)
    with pytest.raises(sdm.SDMError, match="truncation 0 must be"):
        class_maps(LABELS, truncate=0)
