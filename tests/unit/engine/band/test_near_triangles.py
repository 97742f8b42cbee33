"""Blocks that triangles mark, as on a GPU: the bands are those of blocks that descents of the tree find."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere, torus
from sdm.engine.band import near_blocks
from sdm.kernels.band import near_triangles


def block(*size: float) -> sdm.TriangleMesh:
    """A box of twelve triangles, some of which pass near hundreds of columns of blocks."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32) * np.float32(size)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return sdm.TriangleMesh(vertices, [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


@pytest.mark.parametrize("room", [0, 2, near_triangles.MOST_LARGE])
@pytest.mark.parametrize("threads", [0, near_triangles.MOST_THREADS])
def test_the_band_does_not_depend_on_who_marks_its_blocks(room, threads, monkeypatch):
    """Of many triangles for each thread, of one, and of large ones with and without room in their list."""
    turned = block(1.0, 0.8, 0.7)
    turned = sdm.TriangleMesh(
        turned.vertices @ torch.tensor([[0.6, 0.64, 0.48], [-0.8, 0.48, 0.36], [0, -0.6, 0.8]]), turned.faces
    )
    for mesh, size in ((block(1, 0.9, 0.5), 180), (turned, 160), (sdm.TriangleMesh(*torus(500)), 70)):
        grid = sdm.Grid.around(mesh, size)
        cut = sdm.Grid(np.add(grid.origin, 0.3), grid.spacing, (90, 60, 70))
        wanted = [sdm.narrow_band(mesh, each, device="cpu") for each in (grid, cut)]
        with monkeypatch.context() as patch:
            patch.setattr(near_blocks, "BY_TRIANGLES", ("cpu",))
            patch.setattr(near_blocks, "MOST_LARGE", room)
            patch.setattr(near_triangles, "MOST_THREADS", threads)
            found = [sdm.narrow_band(mesh, each, device="cpu") for each in (grid, cut)]
        for one, other in zip(found, wanted, strict=True):
            assert torch.equal(one.blocks, other.blocks)
            assert torch.equal(one.values, other.values)
            assert torch.equal(one.inside, other.inside)


def test_a_mesh_far_from_its_grid(monkeypatch):
    monkeypatch.setattr(near_blocks, "BY_TRIANGLES", ("cpu",))
    mesh = sdm.TriangleMesh(*sphere(5))
    for place in (-1e6, -9.0, 9.0, 1e6):
        assert len(sdm.narrow_band(mesh, sdm.Grid((place,) * 3, (0.1,) * 3, (30,) * 3), device="cpu").blocks) == 0
