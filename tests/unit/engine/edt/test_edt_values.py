"""Masks whose distance transforms can be told by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt

import sdm
from sdm.engine.distance_transform import euclidean_distance_transform

INF = math.inf


def single(shape=(4, 5, 6), at=(1, 2, 3)) -> torch.Tensor:
    mask = torch.zeros(shape, dtype=torch.bool)
    mask[at] = True
    return mask


def test_a_single_voxel(device):
    mask = single().to(device)
    values = euclidean_distance_transform(mask, (1.0, 2.0, 0.5)).cpu()
    i, j, k = torch.meshgrid(*(torch.arange(n) for n in mask.shape), indexing="ij")
    expected = torch.sqrt((i - 1.0) ** 2 + (2.0 * (j - 2)) ** 2 + (0.5 * (k - 3)) ** 2)
    torch.testing.assert_close(values, expected, rtol=2.0**-22, atol=0)


def test_faces_are_half_a_voxel_away(device):
    mask = single((3, 3, 3), (1, 1, 1)).to(device)
    values = euclidean_distance_transform(mask, (1.0, 2.0, 4.0), signed=True, surface="faces").cpu()
    assert values[1, 1, 1] == -0.5
    assert values[0, 1, 1] == 0.5
    assert values[1, 0, 1] == 1.0
    assert values[1, 1, 0] == 2.0
    torch.testing.assert_close(values[0, 0, 0], torch.tensor(math.sqrt(0.25 + 1 + 4)))


def test_a_row_by_hand():
    row = torch.tensor([0, 0, 1, 1, 1, 0, 1]).bool()
    for shape in ((7, 1, 1), (1, 7, 1), (1, 1, 7)):
        mask = row.reshape(shape)
        signed = euclidean_distance_transform(mask, 2.0, signed=True).flatten()
        assert signed.tolist() == [4, 2, -2, -4, -2, 2, -2]
        assert euclidean_distance_transform(mask, 2.0).flatten().tolist() == [4, 2, 0, 0, 0, 2, 0]
        faces = euclidean_distance_transform(mask, 2.0, signed=True, surface="faces").flatten()
        assert faces.tolist() == [3, 1, -1, -3, -1, 1, -1]


@pytest.mark.parametrize("surface", ["centres", "faces"])
def test_without_foreground_or_background(surface, device):
    empty, full = torch.zeros(3, 4, 5, device=device), torch.ones(3, 4, 5, device=device)

    def values(mask, **options):
        found = euclidean_distance_transform(mask, surface=surface, **options).unique()
        assert len(found) == 1
        return found.item()

    assert values(empty) == INF
    assert values(empty, signed=True) == INF
    assert values(full) == 0
    assert values(full, signed=True) == -INF
    assert values(empty, missing=7.0) == 7
    assert values(full, missing=7.0, signed=True) == -7
    assert values(full, missing=0.0, signed=True) == 0


def test_samples_of_a_batch_do_not_mix(device):
    batch = torch.stack([single(), ~single(), torch.zeros(4, 5, 6).bool(), single(at=(0, 0, 0))]).to(device)
    for layout in (batch, batch[:, None]):
        values = euclidean_distance_transform(layout, (1, 2, 3), signed=True)
        assert values.shape == layout.shape
        for n in range(4):
            assert torch.equal(values[n].squeeze(), euclidean_distance_transform(batch[n], (1, 2, 3), signed=True))


def test_any_type_and_layout():
    mask = single()
    expected = euclidean_distance_transform(mask)
    for other in (mask.float() * 0.3, mask.to(torch.uint8) * 255, -mask.long(), mask.double().requires_grad_()):
        assert torch.equal(euclidean_distance_transform(other), expected)
    turned = mask.permute(2, 0, 1)
    assert torch.equal(euclidean_distance_transform(turned), expected.permute(2, 0, 1))
    assert torch.equal(mask, single())


def test_no_voxels():
    assert euclidean_distance_transform(torch.zeros(0, 1, 3, 4, 5)).shape == (0, 1, 3, 4, 5)
    assert euclidean_distance_transform(torch.zeros(3, 0, 5)).shape == (3, 0, 5)


def test_batches_beyond_a_launch_are_split(monkeypatch):
    import sdm.engine.distance_transform as module

    batch = torch.rand(5, 4, 3, 8, generator=torch.Generator().manual_seed(0)) < 0.2
    expected = euclidean_distance_transform(batch, signed=True)
    monkeypatch.setattr(module, "MOST_VOXELS", 2 * 4 * 3 * 32)
    assert torch.equal(euclidean_distance_transform(batch, signed=True), expected)


@pytest.mark.parametrize("kind", [bool, np.uint8, np.float32, np.uint16, ">i4"])
def test_arrays_in_arrays_out(kind):
    mask = np.random.default_rng(0).random((2, 5, 6, 7)) > 0.7
    found = sdm.euclidean_distance_transform(mask.astype(kind)[:, ::-1], (1, 2, 3), signed=True)
    assert isinstance(found, np.ndarray)
    expected = sdm.euclidean_distance_transform(torch.from_numpy(mask[:, ::-1].copy()), (1, 2, 3), signed=True)
    np.testing.assert_array_equal(found, expected.numpy())


def _packed(mask: np.ndarray) -> np.ndarray:
    records = np.zeros(mask.shape, [("tag", "u1"), ("label", "<i4")])
    records["label"] = mask
    return records["label"]


KINDS = ["?", "u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f2", "f4", "f8", "g", ">u2", ">i8", ">f8"]


@pytest.mark.parametrize("kind", [*KINDS, "packed", "list"])
@pytest.mark.parametrize("filled", ["some", "none", "all"])
def test_every_type_against_scipy(kind, filled):
    """In float64, voxels of three sizes: within float32's roundings, and of labels the same."""
    share = {"some": 0.03, "none": 0.0, "all": 1.0}[filled]
    mask = np.random.default_rng(0).random((17, 12, 21)) < share
    given = _packed(mask) if kind == "packed" else mask.tolist() if kind == "list" else mask.astype(kind)
    spacing = (0.8, 2.5, 1.1)
    wanted = distance_transform_edt(~mask, spacing) if share else np.full(mask.shape, np.inf)
    inside = distance_transform_edt(mask, spacing) if share < 1 else np.full(mask.shape, np.inf)
    found = sdm.euclidean_distance_transform(given, spacing)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=3e-7)
    signed = sdm.euclidean_distance_transform(given, spacing, signed=True)
    np.testing.assert_allclose(signed, np.where(mask, -inside, wanted), rtol=3e-7)
    if kind not in ("?", "list"):
        np.testing.assert_array_equal(sdm.euclidean_distance_transform(given, spacing, classes=[1])[0], found)


def test_no_numbers():
    with pytest.raises(sdm.SDMError, match="numbers or truth values, not <U1"):
        sdm.euclidean_distance_transform(np.full((2, 2, 2), "a"))
