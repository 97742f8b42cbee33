"""Distance transforms of many classes: bit for bit those of their masks, in all shapes and types."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm import euclidean_distance_transform as edt

SPACING = (0.7, 1.0, 1.6)


def blobs(shape=(11, 9, 40), device="cpu") -> torch.Tensor:
    """Labels 0 to 5 in boxes that leave slices of each class empty, but for noise of label 4; no 3."""
    labels = torch.zeros(shape, dtype=torch.uint8)
    for value, part in {1: np.s_[2:5], 2: np.s_[5:6], 5: np.s_[9:]}.items():
        labels[part, 2:7, 5:25] = value
    noise = torch.rand(shape, generator=torch.Generator().manual_seed(0)) < 0.02
    return labels.masked_fill(noise, 4).to(device)


@pytest.mark.parametrize("surface", ["centres", "faces"])
@pytest.mark.parametrize("signed", [False, True])
def test_bit_for_bit_as_masks(signed, surface, device):
    labels = blobs(device=device)
    found = edt(labels, SPACING, classes=[5, 1, 2, 3, 4], signed=signed, surface=surface)
    assert found.shape == (5, 11, 9, 40)
    for value, one in zip((5, 1, 2, 3, 4), found, strict=True):
        assert torch.equal(one, edt(labels == value, SPACING, signed=signed, surface=surface))


def test_slices_without_foreground_are_measured_too():
    from scipy.ndimage import distance_transform_edt

    for mask in (blobs() == 2, blobs() == 5, blobs() != 4):
        wanted = distance_transform_edt(~mask.numpy(), SPACING) - distance_transform_edt(mask.numpy(), SPACING)
        np.testing.assert_allclose(edt(mask, SPACING, signed=True), wanted, rtol=1e-6)


def test_batches_and_channels():
    labels = torch.stack([blobs(), blobs().flip(0)])
    wanted = torch.stack([edt(one, SPACING, classes=2, signed=True) for one in labels])
    assert wanted.shape == (2, 2, 11, 9, 40)
    assert torch.equal(edt(labels, SPACING, classes=2, signed=True), wanted)
    assert torch.equal(edt(labels[:, None], SPACING, classes=[1, 2], signed=True), wanted)
    assert torch.equal(
        edt(labels.transpose(1, 2).contiguous().transpose(1, 2), SPACING, classes=2, signed=True), wanted
    )


@pytest.mark.parametrize("dtype", [torch.int64, torch.int16, torch.float32, torch.float16, torch.bfloat16])
def test_types(dtype):
    wanted = edt(blobs(), classes=[1, 2])
    assert torch.equal(edt(blobs().to(dtype), classes=[1, 2]), wanted)


def test_numpy_in_and_out():
    labels = blobs().numpy()
    found = edt(labels, SPACING, classes=(1, 2), signed=True)
    assert isinstance(found, np.ndarray)
    np.testing.assert_array_equal(found, edt(blobs(), SPACING, classes=(1, 2), signed=True))
    np.testing.assert_array_equal(edt(labels[::-1], SPACING, classes=(1, 2), signed=True), found[:, ::-1])


def test_all_values_that_are_there():
    assert torch.equal(edt(blobs(), classes="all"), edt(blobs(), classes=[1, 2, 4, 5]))


def test_values_beyond_the_type_are_not_there():
    # 257 is 1 in eight bits.
    assert edt(blobs(), classes=[257, -1]).isinf().all()


@pytest.mark.parametrize("kind", ["torch", "numpy"])
def test_out(kind):
    labels = blobs() if kind == "torch" else blobs().numpy()
    wanted = edt(labels, classes=3, signed=True)
    out = torch.full((3, 11, 9, 40), 7.0) if kind == "torch" else np.full((3, 11, 9, 40), 7, np.float32)
    assert edt(labels, classes=3, signed=True, out=out) is out
    np.testing.assert_array_equal(out, wanted)
    single = out[0]
    edt(labels, out=single)
    np.testing.assert_array_equal(out[0], edt(labels))
    with pytest.raises(sdm.SDMError, match=r"float32 of shape \(2, 11, 9, 40\) on cpu"):
        edt(labels, classes=2, out=out)


@pytest.mark.parametrize(
    ("classes", "message"),
    [
        ([], "no classes to measure"),
        ("every", "classes are 'every'"),
        ([1, 1], "whole numbers, each once"),
        ([1.5], "whole numbers, each once"),
    ],
)
def test_classes_that_are_none(classes, message):
    with pytest.raises(sdm.SDMError, match=message):
        edt(blobs(), classes=classes)
    with pytest.raises(sdm.SDMError, match="no classes"):
        edt(torch.zeros(3, 3, 3), classes="all")


def test_operators(device):
    labels = blobs((2, 5, 9), device)[None]
    arguments = (labels, [1, 4], [1.0, 2.0, 0.5], 0.5, True, float("inf"))
    torch.library.opcheck(torch.ops.sdm.euclidean_distance_transforms.default, arguments)
    torch.library.opcheck(torch.ops.sdm.nearest_voxels.default, (labels != 0, [1.0, 2.0, 0.5], 0.0))


@pytest.mark.parametrize("spacing", [SPACING, 1.0])
def test_classes_side_by_side(spacing, device, monkeypatch):
    """Blocks of random classes that border on each other: inside distances of all come from one volume."""
    # Some of the classes at a time.
    monkeypatch.setattr("sdm.engine.edt.passes.TOGETHER", 3 * 20 * 21 * 32)
    # By a thread a line on a GPU, however few they are.
    monkeypatch.setattr("sdm.engine.edt.passes.FEWEST_LINES", 0)
    small = torch.randint(0, 8, (5, 6, 7), generator=torch.Generator().manual_seed(1))
    labels = small.repeat_interleave(4, 0).repeat_interleave(3, 1)[:, :17].repeat_interleave(3, 2).byte().to(device)
    found = edt(labels, spacing, classes=8, signed=True, surface="faces")
    for value, one in enumerate(found, 1):
        assert torch.equal(one, edt(labels == value, spacing, signed=True, surface="faces"))


def test_more_classes_than_a_byte_tells_apart():
    labels = torch.arange(300, dtype=torch.int32).reshape(5, 6, 10).repeat(2, 1, 1)
    found = edt(labels, classes="all", signed=True)
    assert found.shape == (299, 10, 6, 10)
    for value in (1, 255, 256, 299):
        assert torch.equal(found[value - 1], edt(labels == value, signed=True))
