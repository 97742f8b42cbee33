"""The boundary's share in float64 by eight edges at once is that of one after the other."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.dirty_meshes.by_code import boxes, loose, sheets, torn, turned
from sdm.bench.common.meshes import torus
from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import SCALE, Tree
from sdm.kernels.winding.boundary_term import Boundary, boundary_winding
from sdm.kernels.winding.eights.exact_sum import exact_share


@wp.kernel(enable_backward=False)
def _both(tree: Tree, boundary: Boundary, places: wp.array(dtype=wp.vec3d), found: wp.array(dtype=wp.vec2d)):
    i = wp.tid()
    one = boundary_winding(boundary, tree, 0, places[i])
    found[i] = wp.vec2d(one, exact_share(boundary, tree, 0, places[i]))


@pytest.mark.parametrize(
    "mesh",
    [torn(torus(2000), 0.1), turned(torus(2000), 0.5), sheets(12), boxes(12), loose(torus(300), 0.01)],
    ids=["torn", "turned", "sheets", "boxes", "loose"],
)
def test_eight_at_once_are_as_one_after_the_other(mesh):
    vertices, faces = mesh
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    tree, winding = structure.view[:2]
    scale = float(tree.frame.numpy()[SCALE])
    rng = np.random.default_rng(0)
    low, high = vertices.min(0), vertices.max(0)
    places = scale * (low + (high - low) * rng.uniform(-0.3, 1.3, (600, 3)))
    # On corners, on the lines along x through them, and beside those; and far off the lattice.
    ends = winding.boundary.ends.numpy()
    places[:100] = ends[rng.integers(len(ends), size=100)]
    places[100:200] = ends[rng.integers(len(ends), size=100)] + [[-0.25, 0, 0]]
    places[200:300] = ends[rng.integers(len(ends), size=100)] + 1e-7 * rng.normal(size=(100, 3))
    places[300:310] *= 50
    found = wp.zeros(len(places), dtype=wp.vec2d, device="cpu")
    inputs = [tree, winding.boundary, wp.array(places, dtype=wp.vec3d, device="cpu"), found]
    wp.launch(_both, len(places), inputs=inputs, device="cpu")
    one, eight = found.numpy().T
    # At a corner itself an angle is of two numbers that are nearly zero.
    room = np.where(np.arange(len(places)) < 300, 1e-7, 1e-12)
    assert (np.abs(one - eight) < room).all(), np.abs(one - eight).max()
