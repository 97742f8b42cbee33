"""The families' torch operators: fake implementations, gradients, and what they leave alone."""

from __future__ import annotations

import pytest
import torch

from sdm.shapes import Family, families

OPERATORS = {"cochlea": "cochlea_vertices", "geometric-shapes": "solids_vertices", "mesh-folder": "warped_vertices"}


@pytest.fixture(params=families)
def family(request) -> Family:
    return families[request.param].example()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", OPERATORS)
def test_opcheck(name):
    family = families[name].example()
    theta = family.sample(2, device="cpu").requires_grad_()
    tables = list(family._tables)
    count = family.vertices(theta).shape[1]
    torch.library.opcheck(getattr(torch.ops.sdm, OPERATORS[name]), (theta, tables, count))


def test_gradient_leaves_its_input_alone(family):
    theta = family.sample(2, device="cpu").requires_grad_()
    vertices = family.vertices(theta)
    upstream = torch.randn_like(vertices)
    before = upstream.clone()
    first = torch.autograd.grad(vertices, theta, upstream, retain_graph=True)[0]
    second = torch.autograd.grad(vertices, theta, upstream)[0]
    assert torch.equal(upstream, before)
    torch.testing.assert_close(first, second)


def test_gradient_of_a_strided_upstream(family):
    theta = family.sample(2, device="cpu").requires_grad_()
    first = torch.autograd.grad(family.vertices(theta).sum(), theta)[0]
    second = torch.autograd.grad(family.vertices(theta), theta, torch.ones(1).expand(family.vertices(theta).shape))[0]
    torch.testing.assert_close(first, second)


def test_empty_batch(family):
    theta = torch.empty(0, len(family.parameters))
    assert family.vertices(theta).shape[0] == 0


def test_strided_and_double_theta(family):
    theta = family.sample(6, device="cpu")
    assert torch.equal(family.vertices(theta[::2]), family.vertices(theta)[::2])
    assert torch.equal(family.vertices(theta.double()), family.vertices(theta))
