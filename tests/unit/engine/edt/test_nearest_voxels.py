"""Nearest voxels and their labels: the distances end there, and no other is nearer."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm import euclidean_distance_transform as edt
from tests.unit.engine.edt.test_classes import SPACING, blobs


def distance_to(index: torch.Tensor, half: float = 0.0) -> torch.Tensor:
    here = torch.stack(torch.meshgrid(*(torch.arange(n) for n in index.shape[:3]), indexing="ij"), -1)
    steps = ((index - here).abs().double() - half).clamp(min=0)
    return (steps * torch.tensor(SPACING, dtype=torch.float64)).norm(dim=-1)


@pytest.mark.parametrize("surface", ["centres", "faces"])
def test_distances_end_there(surface, device):
    labels = blobs(device=device)
    distance, nearest = edt(labels, SPACING, surface=surface, return_nearest=True)
    assert nearest.index.dtype == torch.int32
    assert torch.equal(distance, edt(labels, SPACING, surface=surface))
    found = distance_to(nearest.index.cpu(), sdm.engine.distance_transform.SURFACES[surface])
    np.testing.assert_allclose(distance.cpu(), found, rtol=1e-6)
    x, y, z = nearest.index.long().unbind(-1)
    assert torch.equal(labels[x, y, z], nearest.label)
    assert nearest.label.dtype == labels.dtype
    assert nearest.label.min() > 0
    # A voxel of the foreground is its own.
    assert torch.equal(nearest.label[labels != 0], labels[labels != 0])


def test_classes_have_nearest_voxels_each():
    distance, nearest = edt(blobs(), SPACING, classes=[1, 3, 5], return_nearest=True)
    assert nearest.index.shape == (3, 11, 9, 40, 3)
    assert (nearest.index[1] == -1).all()
    np.testing.assert_allclose(distance[2], distance_to(nearest.index[2]), rtol=1e-6)
    wanted = torch.tensor([1, 5], dtype=torch.uint8)[distance[[0, 2]].argmin(0)]
    assert torch.equal(nearest.label, wanted)


def test_nothing_to_be_near_to():
    distance, nearest = edt(np.zeros((3, 4, 5), np.int16), return_nearest=True)
    assert np.isinf(distance).all()
    assert isinstance(nearest.index, np.ndarray)
    assert (nearest.index == -1).all()
    assert (nearest.label == 0).all()
    assert nearest.label.dtype == np.int16


def test_batches():
    labels = torch.stack([blobs(), blobs().flip(1)])[:, None]
    _, nearest = edt(labels, SPACING, return_nearest=True)
    assert nearest.index.shape == (2, 1, 11, 9, 40, 3)
    assert torch.equal(nearest.label[1, 0], edt(labels[1, 0], SPACING, return_nearest=True)[1].label)


def test_signed_transforms_have_two():
    with pytest.raises(sdm.SDMError, match="two nearest voxels everywhere"):
        edt(blobs(), signed=True, return_nearest=True)
