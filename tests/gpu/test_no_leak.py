"""Hundreds of meshes of all sizes and kinds: the device's memory stays flat."""

from __future__ import annotations

import gc

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case, sphere

pytestmark = [pytest.mark.gpu, pytest.mark.usefixtures("whole_gpu")]


def _one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(4 + seed % 23)
    if seed % 10 == 0:
        case = load_case("random soup")
        vertices, faces = case.vertices, case.faces
    leaf = torch.tensor(vertices, device="cuda", requires_grad=True)
    index = sdm.MeshIndex(sdm.TriangleMesh(leaf, faces[seed % 3 :].copy()))
    index.signed_distance(rng.normal(size=(int(rng.integers(10, 50_000)), 3))).sum().backward()
    grid = sdm.Grid([-1.2] * 3, [0.1] * 3, rng.integers(1, 40, 3))
    index.signed_distance_map(grid)
    index.update(2 * vertices)
    index.winding_number([[0.0, 0, 0]])
    with torch.cuda.stream(torch.cuda.Stream() if seed % 2 else torch.cuda.current_stream()):
        sdm.signed_distance_maps(np.stack([vertices] * 3), faces, grid, device="cuda")
    torch.cuda.synchronize()


def _used() -> tuple[int, int]:
    """Bytes in torch's tensors, and bytes taken from the device once torch has given back what it only keeps."""
    gc.collect()
    torch.cuda.synchronize()
    torch.cuda.empty_cache()
    free, total = torch.cuda.mem_get_info()
    return torch.cuda.memory_allocated(), total - free


def _grown(few: int, many: int) -> None:
    for seed in range(few):
        _one(seed)
    tensors, device = _used()
    for seed in range(few, many):
        _one(seed)
    more_tensors, more_device = _used()
    assert more_tensors <= tensors + (1 << 20)
    # Warp's own pool and the driver keep some.
    assert more_device <= device + (64 << 20)


def test_200_meshes():
    _grown(60, 200)


@pytest.mark.slow
def test_2000_meshes():
    _grown(200, 2000)
