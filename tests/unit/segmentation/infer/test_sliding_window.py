"""Windows: what a network says of each voxel is put back in its place."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.segmentation import largest_component, sliding_window


@pytest.mark.parametrize("shape", [(20, 17, 9), (8, 8, 8), (5, 20, 6)])
@pytest.mark.parametrize("stride", [None, (8, 8, 8), (3, 5, 8)])
def test_the_identity_gives_the_image(shape, stride):
    image = torch.randn(shape)
    found = sliding_window(lambda x: x, image, (8, 8, 8), stride=stride, batch=3)
    torch.testing.assert_close(found, image, atol=1e-5, rtol=1e-5)


def test_overlapping_windows_are_averaged():
    """A network that tells voxels by where they are in the window: the middle counts most."""
    window = torch.zeros(1, 1, 8, 8, 8)
    window[..., 4:, :, :] = 1.0
    found = sliding_window(window.expand_as, torch.zeros(12, 8, 8), (8, 8, 8), stride=(4, 8, 8))
    profile = found[:, 0, 0]
    assert profile[:4].tolist() == [0, 0, 0, 0]
    assert profile[8:].tolist() == [1, 1, 1, 1]
    # The first window says 1, the second, nearer to its own border, 0.
    assert profile[4] > 0.8
    assert profile[7] < 0.2
    assert (profile[4:8].diff() < 0).all()


@pytest.mark.parametrize("stride", [(9, 8, 8), (0, 8, 8), (8, 8)])
def test_strides_that_leave_gaps(stride):
    with pytest.raises(SDMError, match="gaps"):
        sliding_window(lambda x: x, torch.zeros(20, 20, 20), (8, 8, 8), stride=stride)


def test_the_largest_component():
    label = torch.zeros(9, 9, 9, dtype=torch.bool)
    label[0, 0, 0:3] = True
    label[4:6, 4:6, 4:6] = True
    label[6, 6, 6] = True
    kept = largest_component(label)
    assert int(kept.sum()) == 9
    assert kept[6, 6, 6]
    assert not kept[0].any()
    assert not largest_component(torch.zeros(3, 3, 3, dtype=torch.bool)).any()
