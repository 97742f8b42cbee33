"""Second derivatives and those in forward mode are not there, and whoever asks is told instead of misled."""

from __future__ import annotations

import pytest
import torch
from torch.autograd import forward_ad

import sdm
from sdm.bench.common.meshes import cube


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
    """The gradient that comes from a loss may depend on other things, and ours is linear in it."""
    points = torch.tensor([[3.0, 2.0, 0.0]], requires_grad=True)
    factor = torch.tensor(5.0, requires_grad=True)
    values = sdm.signed_distance(sdm.TriangleMesh(*cube()), points, device="cpu")
    (gradient,) = torch.autograd.grad((factor * values).sum(), points, create_graph=True)
    (slope,) = torch.autograd.grad(gradient.sum(), factor)
    torch.testing.assert_close(slope, torch.tensor((2 + 1) / 5**0.5))


GRID = sdm.Grid((0, 0, 0), (1, 1, 1), (2, 3, 4))
MESH = sdm.TriangleMesh(*cube())
OF_POINTS = {
    "distance": lambda _, at: sdm.signed_distance(MESH, at, device="cpu"),
    "closest": lambda _, at: sdm.signed_distance(MESH, at, return_closest=True, device="cpu")[0],
    "index": lambda index, at: index.signed_distance(at),
    "winding number": lambda index, at: index.winding_number(at),
}
OF_VERTICES = {
    "distance": lambda at: sdm.signed_distance(sdm.TriangleMesh(at, cube()[1]), [[3.0, 2.0, 0.0]], device="cpu"),
    "map": lambda at: sdm.signed_distance_map(sdm.TriangleMesh(at, cube()[1]), GRID, device="cpu").values,
    "index": lambda at: sdm.MeshIndex(sdm.TriangleMesh(at, cube()[1]), "cpu"),
    "update": lambda at: sdm.MeshIndex(MESH, "cpu").update(at),
    "maps": lambda at: sdm.signed_distance_maps(at[None], cube()[1], GRID, device="cpu"),
}


@pytest.mark.parametrize("name", OF_POINTS)
@pytest.mark.parametrize("transform", [torch.func.vmap, torch.func.grad, torch.func.jacrev])
def test_transforms_of_torch_func_are_refused_in_words(name, transform):
    index = sdm.MeshIndex(MESH, "cpu")
    with pytest.raises(NotImplementedError, match=r"give points of any shape \(...,3\)"):
        transform(lambda at: OF_POINTS[name](index, at).sum())(torch.rand(4, 2, 3))


# Torch itself warns of what torch deprecates.
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.parametrize("name", OF_POINTS)
def test_forward_mode_for_points(name):
    at = torch.tensor([[3.0, 2.0, 0.0]])
    index = sdm.MeshIndex(MESH, "cpu")
    with pytest.raises(NotImplementedError, match="reverse mode"):
        torch.func.jvp(lambda at: OF_POINTS[name](index, at), (at,), (at,))


# Torch itself warns of what torch deprecates.
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.parametrize("name", OF_VERTICES)
def test_forward_mode_for_vertices(name):
    at = torch.as_tensor(cube()[0])
    with forward_ad.dual_level(), pytest.raises(NotImplementedError, match="reverse mode"):
        OF_VERTICES[name](forward_ad.make_dual(at, torch.ones_like(at)))
