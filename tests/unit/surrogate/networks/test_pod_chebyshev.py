"""Proper orthogonal decomposition, and polynomials for its coefficients."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.surrogate import GRID, PODChebyshev
from sdm.surrogate.networks.pod_chebyshev import decompose, total_degree


def test_modes_are_those_of_the_singular_value_decomposition():
    generator = torch.Generator().manual_seed(0)
    maps = torch.randn(30, 7, generator=generator) @ torch.randn(7, 200, generator=generator) + 5
    mean, modes, spread = decompose(maps, 7)
    torch.testing.assert_close(mean, maps.mean(0))
    torch.testing.assert_close(modes @ modes.T, torch.eye(7), atol=1e-5, rtol=0)
    values = torch.linalg.svdvals((maps - maps.mean(0)).double())[:7] / 30**0.5
    torch.testing.assert_close(spread.double(), values, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close((maps - mean) @ modes.T @ modes + mean, maps, atol=1e-3, rtol=0)


def test_more_modes_than_maps_are_refused():
    with pytest.raises(SDMError, match="5 modes"):
        decompose(torch.randn(5, 20), 5)


def test_there_are_as_many_polynomials_as_the_binomial_coefficient_says():
    assert len(total_degree(4, 8)) == 495
    assert int(total_degree(4, 8).sum(1).max()) == 8


def test_maps_that_are_polynomials_of_theta_are_found_again():
    family, generator = Cochlea(), torch.Generator().manual_seed(0)
    fields = torch.randn(3, GRID.size, generator=generator)

    def maps(theta):
        x = family.to_unit(theta) * 2 - 1
        parts = torch.stack([x[:, 0] * x[:, 1], x[:, 2] ** 2, x[:, 3]], 1)
        return (parts @ fields).reshape(-1, 1, *GRID.shape)

    theta, other = family.sample(40, device="cpu"), family.sample(3, seed=1, device="cpu")
    model = PODChebyshev(modes=3, degree=2).fit(theta, maps(theta))
    torch.testing.assert_close(model(other), maps(other), atol=2e-3, rtol=0)
