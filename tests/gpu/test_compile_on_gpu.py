"""signed_distance inside torch.compile on a GPU: the same values and gradients, also on a side stream."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.meshes import torus

pytestmark = [pytest.mark.gpu, pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")]


@pytest.fixture(autouse=True)
def fresh_compiler():
    torch.compiler.reset()
    yield
    torch.compiler.reset()


@pytest.mark.parametrize("backend", ["aot_eager", pytest.param("inductor", marks=pytest.mark.slow)])
@pytest.mark.parametrize("own_stream", [False, True])
def test_values_and_gradients(backend, own_stream):
    vertices, faces = (torch.tensor(array).cuda() for array in torus(1024))
    points = torch.randn(4999, 3, generator=torch.Generator().manual_seed(0)).cuda()

    def loss(corners: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
        mesh = sdm.TriangleMesh(corners, faces, check=False)
        return (sdm.signed_distance(mesh, 2 * at) ** 2).mean()

    results = []
    side = torch.cuda.Stream()
    for function in (loss, torch.compile(loss, fullgraph=True, backend=backend)):
        stream = side if own_stream else torch.cuda.current_stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            leaf, at = vertices.clone().requires_grad_(), points.clone().requires_grad_()
            value = function(leaf, at)
            value.backward()
        torch.cuda.synchronize()
        results.append((value.detach(), leaf.grad, at.grad))
    for plain, compiled in zip(*results, strict=True):
        torch.testing.assert_close(compiled, plain, atol=1e-6, rtol=1e-4)
