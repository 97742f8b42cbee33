"""The families' torch operators: fake implementations, gradients, and what they leave alone."""

from __future__ import annotations

import pytest
import torch

from sdm.core.demo_mesh import demo_mesh
from sdm.shapes import Cochlea, Family, GeometricShapes, MeshFolder

FAMILIES = {
    "cochlea": lambda: Cochlea(500),
    "solids": lambda: GeometricShapes(triangles=48, shift=0.5),
    "warped": lambda: MeshFolder([demo_mesh(rings=41, segments=16, cap_rings=3)]),
}


@pytest.fixture(params=FAMILIES)
def family(request) -> Family:
    return FAMILIES[request.param]()


def operator(family: Family):
    name = {"cochlea": "cochlea_vertices", "geometric-shapes": "solids_vertices", "mesh-folder": "warped_vertices"}
    return getattr(torch.ops.sdm, name[family.name])


@pytest.mark.filterwarnings("ignore")
def test_opcheck(family):
    theta = family.sample(2, device="cpu").requires_grad_()
    tables = list(family._tables)
    count = family.vertices(theta).shape[1]
    torch.library.opcheck(operator(family), (theta, tables, count))


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
