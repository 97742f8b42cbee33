"""Features of theta: one by one in Python's numbers, and many at a time by torch."""

from __future__ import annotations

import torch

from sdm.shapes import Cochlea
from sdm.surrogate.networks.theta_features import ThetaFeatures


def test_features_of_one_are_those_of_many():
    features, theta = ThetaFeatures(), Cochlea().sample(8, seed=3, device="cpu")
    wanted = features(theta)
    assert wanted.shape == (8, ThetaFeatures.width)
    found = torch.tensor([features.of_one(row) for row in theta.tolist()])
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)
