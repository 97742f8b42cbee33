"""Families on a GPU: the same samples as on the CPU, on the current stream, without waiting for the device."""

from __future__ import annotations

import pytest
import torch

from sdm.core.demo_mesh import demo_mesh
from sdm.shapes import Cochlea, Family, GeometricShapes, MeshFolder, sobol, uniform

pytestmark = pytest.mark.gpu

FAMILIES = {
    "cochlea": Cochlea,
    "solids": lambda: GeometricShapes(shift=0.5),
    "warped": lambda: MeshFolder([demo_mesh(rings=41, segments=16, cap_rings=3)]),
}


@pytest.fixture(params=FAMILIES)
def family(request) -> Family:
    return FAMILIES[request.param]()


def test_random_numbers_are_those_of_the_cpu():
    index = torch.arange(5, 1000)
    for draw in (uniform, sobol):
        assert torch.equal(draw(3, index.cuda(), 11).cpu(), draw(3, index, 11))


def test_shapes_and_gradients_are_those_of_the_cpu(family):
    here = family.sample(5, device="cpu").requires_grad_()
    there = here.detach().cuda().requires_grad_()
    expected, found = family.vertices(here), family.vertices(there)
    torch.testing.assert_close(found.cpu(), expected, atol=1e-5, rtol=0)
    weights = torch.randn(expected.shape, generator=torch.Generator().manual_seed(0))
    (expected * weights).sum().backward()
    (found * weights.cuda()).sum().backward()
    assert here.grad is not None
    assert there.grad is not None
    scale = 1 + here.grad.abs().amax(0)
    assert float(((there.grad.cpu() - here.grad) / scale).abs().max()) < 1e-3


def test_never_waits_for_the_device(family):
    def once() -> torch.Tensor:
        theta = family.sample(4, seed=1, device="cuda").requires_grad_()
        family.vertices(theta).square().sum().backward()
        assert theta.grad is not None
        return family.vertices(theta.detach())

    expected = once().clone()
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        with torch.cuda.stream(torch.cuda.Stream()):
            again = once()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    torch.cuda.synchronize()
    assert torch.equal(again, expected)
