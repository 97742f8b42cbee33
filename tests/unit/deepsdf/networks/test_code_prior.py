"""The prior over codes: what varies together in the training is likely to do so again."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from sdm.deepsdf import DeepSDF, local, published
from sdm.deepsdf.networks.code_gaussian import REST
from sdm.deepsdf.networks.code_prior import CodePrior


def model(codes: Tensor, **changes: object) -> DeepSDF:
    return DeepSDF(local(global_size=codes.shape[1], grids=(), **changes), nn.Identity(), codes, [], [])


def test_it_is_the_gaussian_of_the_codes() -> None:
    """Against the inverse of the covariance, where there are more codes than numbers."""
    generator = torch.Generator().manual_seed(0)
    codes = torch.randn(200, 3, generator=generator) @ torch.tensor([[2.0, 0.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.3, 0.1]])
    prior = CodePrior(model(codes))
    covariance = torch.cov(codes.T.double()) + REST * torch.cov(codes.T.double()).trace() / 3 * torch.eye(3)
    asked = torch.randn(5, 3, generator=generator)
    away = (asked - codes.mean(0)).double()
    expected = torch.einsum("bi,ij,bj->b", away, torch.linalg.inv(covariance), away)
    torch.testing.assert_close(prior(asked).double(), expected, rtol=1e-4, atol=1e-4)


def test_what_varies_together_stays_together() -> None:
    line = torch.linspace(-1, 1, 9)
    codes = torch.stack([line, line, 0 * line, 0 * line], 1) + 0.5
    prior = CodePrior(model(codes))
    together, apart, new = (torch.tensor([row]) + 0.5 for row in ([0.5, 0.5, 0, 0], [0.5, -0.5, 0, 0], [0, 0, 0.7, 0]))
    assert float(prior(torch.full((1, 4), 0.5))) == pytest.approx(0, abs=1e-6)
    assert 4 * float(prior(together)) < float(prior(apart)) == pytest.approx(float(prior(new)), rel=0.05)


def test_codes_that_do_not_vary_and_the_papers() -> None:
    still = CodePrior(model(torch.ones(1, 4), code_deviation=0.1))
    assert float(still(torch.full((1, 4), 1.1))) == pytest.approx(4.0, rel=1e-4)
    paper = DeepSDF(published(global_size=2), nn.Identity(), torch.ones(3, 2), [], [])
    assert float(CodePrior(paper)(torch.tensor([[3.0, 4.0]]))) == 25.0
