"""signed_distance inside torch.compile, without a break in the graph: the same values and gradients."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.meshes import torus

VERTICES, FACES = (torch.tensor(array) for array in torus(256))
POINTS = torch.randn(64, 3, generator=torch.Generator().manual_seed(0))


@pytest.fixture(autouse=True)
def fresh_compiler():
    torch.compiler.reset()
    yield
    torch.compiler.reset()


def _loss(vertices: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    mesh = sdm.TriangleMesh(vertices, FACES, check=False)
    return (sdm.signed_distance(mesh, 2 * points, device="cpu") ** 2).mean()


# Torch's own compiler warns of what torch deprecates.
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
# "aot_eager" traces forward and backward as the real backend does, and needs no C++ compiler.
@pytest.mark.parametrize("backend", ["aot_eager", pytest.param("inductor", marks=pytest.mark.slow)])
def test_values_and_gradients(backend):
    results = []
    for function in (_loss, torch.compile(_loss, fullgraph=True, backend=backend)):
        vertices, points = VERTICES.clone().requires_grad_(), POINTS.clone().requires_grad_()
        loss = function(vertices, points)
        loss.backward()
        results.append((loss.detach(), vertices.grad, points.grad))
    for plain, compiled in zip(*results, strict=True):
        torch.testing.assert_close(compiled, plain)


def test_a_finished_index():
    index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES, FACES), "cpu")

    def inside(points: torch.Tensor) -> torch.Tensor:
        return index.signed_distance(points) < 0

    compiled = torch.compile(inside, fullgraph=True, backend="aot_eager")
    assert torch.equal(compiled(POINTS), inside(POINTS))
    # Other numbers of points, too.
    assert torch.equal(compiled(POINTS[:7]), inside(POINTS[:7]))
    assert torch.equal(compiled(POINTS[:9]), inside(POINTS[:9]))


def test_closest_points():
    mesh = sdm.TriangleMesh(VERTICES, FACES)

    def to_surface(points: torch.Tensor) -> torch.Tensor:
        values, hit = sdm.signed_distance(mesh, points, return_closest=True, device="cpu")
        return hit.points + 0 * values[:, None]

    compiled = torch.compile(to_surface, fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(POINTS), to_surface(POINTS))
