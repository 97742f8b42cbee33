from __future__ import annotations

import numpy as np
import trimesh

from sdm.core.demo_mesh import demo_mesh


def test_closed_oriented_and_of_one_piece():
    vertices, faces = demo_mesh().numpy()
    solid = trimesh.Trimesh(vertices.astype(np.float64), faces, process=False)
    assert len(faces) == 20_256
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.euler_number == 2
    assert 50 < solid.volume < 52
    assert solid.area_faces.min() > 1e-4


def test_does_not_cut_through_itself():
    """A tube that met itself would have a winding number of 2 there."""
    vertices, faces = demo_mesh(rings=121, segments=24, cap_rings=3).numpy()
    low, high = vertices.min(0), vertices.max(0)
    points = np.random.default_rng(0).uniform(low, high, (500, 3))
    a, b, c = (vertices.astype(np.float64)[faces[:, n]][None] - points[:, None] for n in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    triple = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    winding = 2 * np.arctan2(triple, below).sum(1) / (4 * np.pi)
    rounded = np.round(winding)
    np.testing.assert_allclose(winding, rounded, atol=1e-6)
    assert set(rounded) == {0.0, 1.0}


def test_the_same_every_time():
    first, second = demo_mesh().numpy(), demo_mesh().numpy()
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


def test_finer_and_coarser():
    assert len(demo_mesh(rings=10, segments=6, cap_rings=1)) == 2 * 6 * 12
