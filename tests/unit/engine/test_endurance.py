"""Thousands of different meshes through one process: memory stays flat."""

from __future__ import annotations

import gc
from pathlib import Path

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere

STRETCHES, LEAST = 3, 4 << 20


@pytest.fixture(autouse=True)
def one_torch_thread():
    """Meshes this small are not worth waking threads for."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def _memory() -> int:
    """Bytes of this process's own. Pages of files come and go as the rest of the machine has need of memory."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return sum(int(lines[name].split()[0]) for name in ("RssAnon", "VmSwap")) * 1024


def _one(seed: int) -> None:
    """A mesh of a size of its own, every kind of query, and gradients."""
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(3 + seed % 7)
    faces = faces[seed % 3 :]
    leaf = torch.tensor(vertices + 0.05 * rng.normal(size=vertices.shape).astype(np.float32), requires_grad=True)
    index = sdm.MeshIndex(sdm.TriangleMesh(leaf, faces), "cpu")
    count = int(rng.choice([10, 500, 5000]))
    index.signed_distance(rng.normal(size=(count, 3)).astype(np.float32)).sum().backward()
    grid = sdm.Grid([-1.2] * 3, [0.3] * 3, rng.integers(1, 9, 3))
    index.signed_distance_map(grid).values.sum().backward()
    index.update(2 * vertices)
    index.winding_number([[0.0, 0, 0]])
    sdm.signed_distance_maps(np.stack([vertices, 2 * vertices]), faces, grid, device="cpu")
    assert torch.isfinite(leaf.grad).all()


def _grown(few: int, many: int) -> int:
    """Bytes that memory grows by from `few` meshes on to `many`.

    A leak grows in every such stretch; heaps of threads and libraries that are loaded late grow once.
    """
    for seed in range(few):
        _one(seed)
    grown = []
    for stretch in range(STRETCHES):
        gc.collect()
        before = _memory()
        for seed in range(few, many):
            _one(seed + stretch * many)
        gc.collect()
        grown.append(_memory() - before)
        if grown[-1] < LEAST:
            break
    return min(grown)


def test_110_meshes():
    assert _grown(40, 110) < LEAST


@pytest.mark.slow
def test_2000_meshes():
    assert _grown(200, 2000) < 2 * LEAST
