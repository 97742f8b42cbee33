"""The kernels measure at the very points that `Grid.points` names: products must not be fused on either side."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

import sdm
from sdm.engine.ops import slab_view
from sdm.kernels.geometry.voxel_grid import Slab, voxel

wp.set_module_options({"enable_backward": False})

SHAPE = (7, 12, 40)
turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]


@wp.kernel
def _note(slab: Slab, out: wp.array(dtype=wp.vec3)):
    n = wp.tid()
    k = n % slab.shape[2]
    j = (n / slab.shape[2]) % slab.shape[1]
    out[n] = voxel(slab, n / (slab.shape[2] * slab.shape[1]), j, k)


@pytest.mark.parametrize("direction", [np.eye(3), turn], ids=["straight", "turned"])
@pytest.mark.parametrize("first", [0, 3])
def test_voxel_centres_are_those_of_the_grid_bit_for_bit(direction, first, device):
    # The middle of each axis cancels to a few parts in 1e17, or to nothing: a fused product tells them apart.
    spacing = [0.4, 0.2, 0.1]
    origin = -(direction * spacing) @ [2.0, 5.0, 17.0]
    grid = sdm.Grid(origin, spacing, SHAPE, direction)
    count = SHAPE[0] - first
    flat = tuple(x for row in grid.direction for x in row)
    slab = slab_view(grid.origin, grid.spacing, (count, *SHAPE[1:]), first, flat)
    out = torch.zeros(count * SHAPE[1] * SHAPE[2], 3, device=device)
    wp.launch(_note, len(out), [slab, wp.from_torch(out, dtype=wp.vec3)], device=device)
    assert torch.equal(out.cpu(), grid.points(first).reshape(-1, 3))
