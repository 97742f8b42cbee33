"""The validation set is the same everywhere and for ever."""

from __future__ import annotations

import itertools

import torch

from sdm.shapes import Cochlea
from sdm.surrogate.train.validation import validation_batches, validation_name, validation_theta

NAME = "cochlea-1000-dacd36cca946e5d3"


def test_the_set_is_fixed_and_has_the_corners():
    family = Cochlea()
    theta = validation_theta(family)
    assert theta.shape == (1000, 4)
    family.check(theta)
    corners = {tuple(row) for row in family.to_unit(theta[:16]).round().tolist()}
    assert corners == set(itertools.product((0.0, 1.0), repeat=4))
    assert len(theta.unique(dim=0)) == 1000
    assert validation_name(theta) == NAME


def test_no_training_stream_has_its_shapes():
    family = Cochlea()
    theta = validation_theta(family)[16:]
    for seed in range(3):
        for sampler in ("uniform", "sobol"):
            mine = family.sample(1000, seed=seed, sampler=sampler, device="cpu")
            assert torch.cdist(theta, mine).min() > 0


def test_batches_are_exact_maps_of_the_set():
    theta = validation_theta(Cochlea())[[0, 20]]
    (batch,) = validation_batches(theta, "cpu")
    assert torch.equal(batch.theta, theta)
    assert batch.sdm.shape == (2, 1, 80, 64, 40)
    assert ((batch.sdm < 0).flatten(1).sum(1) > 100).all()
