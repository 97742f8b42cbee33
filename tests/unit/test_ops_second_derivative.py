"""Second derivatives are not there, and whoever asks is told instead of misled."""

from __future__ import annotations

import pytest
import torch

import sdm
from bench.meshes import cube


def _first(points: torch.Tensor) -> torch.Tensor:
    values = sdm.signed_distance(sdm.TriangleMesh(*cube()), points, device="cpu")
    (gradient,) = torch.autograd.grad(values.pow(2).sum(), points, create_graph=True)
    return gradient


def test_asking_is_an_error():
    points = torch.tensor([[3.0, 2.0, 0.0]], requires_grad=True)
    gradient = _first(points)
    torch.testing.assert_close(gradient.detach(), torch.tensor([[4.0, 2.0, 0.0]]))
    with pytest.raises(NotImplementedError, match="once"):
        gradient.sum().backward()


def test_the_factor_in_front_may_be_differentiated():
    """What comes back from a loss may depend on other things, and the gradient is linear in it."""
    points = torch.tensor([[3.0, 2.0, 0.0]], requires_grad=True)
    factor = torch.tensor(5.0, requires_grad=True)
    values = sdm.signed_distance(sdm.TriangleMesh(*cube()), points, device="cpu")
    (gradient,) = torch.autograd.grad((factor * values).sum(), points, create_graph=True)
    (slope,) = torch.autograd.grad(gradient.sum(), factor)
    torch.testing.assert_close(slope, torch.tensor((2 + 1) / 5**0.5))
