"""Crossings of four columns in one word: the winding numbers of one for each voxel, however many triangles cross."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.meshes import sphere
from sdm.engine.acceleration import build
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.winding.column_sums import slab_winding
from sdm.kernels.winding.columns import packed_crossings
from sdm.runtime.torch_warp import as_warp, workspace

CPU = torch.device("cpu")


def winding_of(vertices: np.ndarray, faces: np.ndarray, shape: tuple[int, int, int], first: int = 0) -> np.ndarray:
    """Winding numbers of meshes (B,V,3) at a slab of a grid around [-1,1]^3, from layer `first` on."""
    structure = build(torch.from_numpy(np.ascontiguousarray(vertices, np.float32)), torch.from_numpy(faces))
    tree, winding, *_ = structure.view
    slab = Slab()
    slab.origin, slab.spacing = wp.vec3d(-1.05, -1.1, -1.2), wp.vec3d(*(2.3 / n for n in shape))
    slab.shape, slab.first = wp.vec3i(shape[0] - first, *shape[1:]), first
    values = torch.empty((len(vertices), shape[0] - first, *shape[1:]))
    slab_winding(tree, winding, slab, as_warp(values, wp.float32), workspace(CPU))
    return values.numpy()


def both(monkeypatch: pytest.MonkeyPatch, *given: object) -> tuple[np.ndarray, np.ndarray]:
    plain = winding_of(*given)
    monkeypatch.setitem(packed_crossings.FEWEST, "cpu", 1)
    made = []
    monkeypatch.setattr(
        "sdm.kernels.winding.column_sums.sum_packed",
        lambda *inputs: (made.append(inputs[1].full.numpy()[0]), packed_crossings.sum_packed(*inputs)),
    )
    packed = winding_of(*given)
    assert made
    both.full = bool(made[-1])
    return plain, packed


@pytest.mark.parametrize("shape", [(17, 9, 12), (32, 7, 4), (5, 6, 8)])
def test_closed_and_nested_meshes(monkeypatch, shape):
    vertices, faces = sphere(12, 8)
    nested = np.concatenate([size * vertices for size in (1.0, 0.7, 0.4)])
    all_faces = np.concatenate([faces + len(vertices) * i for i in range(3)]).astype(np.int32)
    plain, packed = both(monkeypatch, np.stack([nested, nested[:, ::-1] * 0.9]), all_faces, shape, 2)
    assert np.array_equal(plain, packed)
    assert plain.max() == 3 or plain.min() == -3
    assert not both.full


@pytest.mark.parametrize("copies", [90, 140, 300])
def test_more_crossings_than_a_byte_counts(monkeypatch, copies):
    vertices, faces = sphere(12, 8)
    moved = np.concatenate([vertices * (1 - 1e-5 * i) for i in range(copies)])
    all_faces = np.concatenate([faces + len(vertices) * i for i in range(copies)]).astype(np.int32)
    plain, packed = both(monkeypatch, moved[None], all_faces, (12, 8, 8))
    assert np.array_equal(plain, packed)
    assert plain.max() == copies
    assert both.full == (copies > 101)


def test_open_mesh(monkeypatch):
    vertices, faces = sphere(12, 8)
    plain, packed = both(monkeypatch, vertices[None], faces[5:].copy(), (16, 12, 20))
    assert np.array_equal(plain, packed)
