"""Bundles of lines find what envelopes find, bit for bit, on a CPU, where a bundle has one line, too."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from sdm import euclidean_distance_transform as edt
from sdm.engine.edt import passes
from sdm.kernels.edt import class_transform

CLASSES = range(5)


def boxes(random: np.random.Generator, shape) -> np.ndarray:
    """Labels of boxes over each other, so that classes leave out slices, rows and whole bundles."""
    labels = np.zeros(shape, np.uint8)
    for label in (1, 2, 3, 1, 4):
        low = [random.integers(n) for n in shape]
        labels[tuple(slice(a, a + 1 + random.integers(n)) for a, n in zip(low, shape, strict=True))] = label
    return labels


def noise(random: np.random.Generator, shape) -> np.ndarray:
    return (random.integers(0, 5, shape) * (random.random(shape) < 0.03)).astype(np.uint8)


def one_other(random: np.random.Generator, shape) -> np.ndarray:
    """All of one label but for a voxel: the farthest sites that there are."""
    labels = np.ones(shape, np.uint8)
    labels.flat[random.integers(labels.size)] = 2
    return labels


@pytest.mark.parametrize("make", [boxes, noise, one_other])
# Shorter than a run, longer than what is found together, fewer lines than lanes and more, no multiples of any.
@pytest.mark.parametrize("shape", [(5, 3, 2), (530, 3, 35), (3, 1050, 17), (70, 66, 33)])
@pytest.mark.parametrize("surface", ["centres", "faces"])
def test_bundles_find_what_envelopes_find(make, shape, surface, device, monkeypatch):
    labels = torch.from_numpy(make(np.random.default_rng(sum(shape)), shape)).to(device)
    monkeypatch.setattr(passes, "FEWEST_LINES", 0)
    for spacing in (1.0, (0.7, 1.0, 1.6)):
        found = []
        for fewest in (1, math.inf):
            monkeypatch.setitem(class_transform.FEWEST_IN_BUNDLE, labels.device.type, fewest)
            found.append(edt(labels, spacing, classes=list(CLASSES), signed=True, surface=surface))
        assert torch.equal(*found)


def test_more_threads_than_a_launch_counts(device, monkeypatch):
    labels = torch.from_numpy(boxes(np.random.default_rng(1), (30, 20, 33))).to(device)
    monkeypatch.setattr(passes, "FEWEST_LINES", 0)
    monkeypatch.setitem(class_transform.FEWEST_IN_BUNDLE, labels.device.type, 1)
    found = []
    for most in (class_transform.MOST_THREADS, 1):
        monkeypatch.setattr(class_transform, "MOST_THREADS", most)
        found.append(edt(labels, classes=4, signed=True))
    assert torch.equal(*found)


def test_bundles_of_unsigned_transforms_and_absent_classes(device, monkeypatch):
    labels = torch.from_numpy(boxes(np.random.default_rng(0), (40, 30, 20))).to(device)
    monkeypatch.setattr(passes, "FEWEST_LINES", 0)
    monkeypatch.setitem(class_transform.FEWEST_IN_BUNDLE, labels.device.type, 1)
    found = edt(labels, (0.7, 1.0, 1.6), classes=[2, 7], missing=9.0)
    assert torch.equal(found[0], edt(labels == 2, (0.7, 1.0, 1.6)))
    assert (found[1] == 9.0).all()
