"""Boundaries on a GPU: those of the CPU, by whichever way, and as few waits as there can be."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case, sphere
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.cap_triangles import cap_triangles
from sdm.topology.face_pairing import neighbours

pytestmark = pytest.mark.gpu


def _torn(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Three shapes of one sphere with holes, a third of its faces loose, half of its zeros negative; on the host."""
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(24)
    faces = faces[rng.random(len(faces)) < 0.97]
    own = rng.random(len(faces)) < 0.3
    index = faces.copy()
    index[own] = len(vertices) + np.arange(3 * own.sum()).reshape(-1, 3)
    all_of_them = np.concatenate([vertices, vertices[faces[own]].reshape(-1, 3)])
    turned = np.where((all_of_them == 0) & (rng.random(all_of_them.shape) < 0.5), -0.0, all_of_them)
    batch = np.stack([turned, 2 * turned, turned + np.float32(1)]).astype(np.float32)
    return torch.tensor(batch), torch.tensor(index.astype(np.int32))


@pytest.mark.parametrize("limit", [1 << 12, 0])
@pytest.mark.parametrize("seed", range(4))
def test_as_on_the_cpu(monkeypatch, limit, seed):
    vertices, faces = _torn(seed)
    expected = boundary_edges(vertices, faces)
    assert len(expected) > 0
    monkeypatch.setattr(sdm.topology.boundary_edges, "MOST_ON_HOST", limit)
    for batch in (vertices, vertices[0]):
        found = boundary_edges(batch.cuda(), faces.cuda())
        assert found.is_cuda
        assert torch.equal(found.cpu(), boundary_edges(batch, faces))
        assert torch.equal(cap_triangles(found).cpu(), cap_triangles(found.cpu()))
    assert torch.equal(neighbours(faces.cuda(), vertices.shape[1]).cpu(), neighbours(faces, vertices.shape[1]))


def _waits(call: Callable[[], object]) -> int:
    """Number of times that torch waits for the device in a call."""
    torch.cuda.synchronize()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            call()
        finally:
            torch.cuda.set_sync_debug_mode("default")
    # The first use of the mode has a warning of its own. A wait for an event, as for the pairing's flags, has none.
    return sum("called a synchronizing" in str(warning.message) for warning in caught)


@pytest.mark.parametrize(("name", "new", "known"), [("torus", 0, 0), ("open hemisphere", 3, 1)])
def test_waits(name, new, known):
    case = load_case(name)
    vertices, faces = torch.tensor(case.vertices).cuda(), torch.tensor(case.faces).cuda()

    def build(faces: torch.Tensor) -> None:
        sdm.MeshIndex(sdm.TriangleMesh(vertices, faces, check=False))

    # Loads what is loaded on first use.
    build(faces.clone())
    other = faces.clone()
    assert _waits(lambda: build(other)) == new
    assert _waits(lambda: build(other)) == known
