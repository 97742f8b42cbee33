"""The Warp brute force gives what the NumPy one gives, on every kind of mesh."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.bench.common import meshes
from sdm.bench.common.oracles.brute_force import Brute
from tests.helpers import oracle


@pytest.mark.parametrize("name", meshes.generated_names())
def test_equals_the_oracle(name):
    case = meshes.load_case(name)
    rng = np.random.default_rng(4)
    low, high = case.box
    size = (high - low).max()
    corner = case.vertices[case.faces[rng.integers(0, len(case), 40)]].astype(float)
    points = np.concatenate(
        [
            rng.uniform(low - 0.2 * size, high + 0.2 * size, (40, 3)),
            (rng.dirichlet(np.ones(3), 40)[:, None] @ corner)[:, 0] + 1e-5 * size * rng.normal(size=(40, 3)),
            corner[:10, 0],
            low + 10 * size * rng.normal(size=(10, 3)),
        ]
    ).astype(np.float32)
    scale = max(np.abs(case.vertices).max(), np.abs(points).max())
    brute = Brute(case.vertices, case.faces)

    d, closest, face = brute.distance(points)
    expected, _, _ = oracle.distance(case.vertices, case.faces, points)
    np.testing.assert_allclose(d, expected, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(np.linalg.norm(points - closest, axis=1), expected, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(brute.distance_to_face(points, face), expected, rtol=0, atol=1e-14 * scale)

    # So near the faces rounding weighs more: each solid angle is good to 1e-16 of the size over the distance.
    w = brute.winding_number(points)
    clear = expected > 1e-7 * scale
    expected = oracle.winding_number(case.vertices, case.faces, points)
    np.testing.assert_allclose(w[clear], expected[clear], rtol=0, atol=2e-8)


def test_threads_and_slices_cover_every_point(monkeypatch):
    import sdm.bench.common.oracles.brute_force

    rng = np.random.default_rng(6)
    vertices, faces = meshes.cube()
    points = rng.normal(size=(1001, 3)).astype(np.float32)
    expected, _, _ = oracle.distance(vertices, faces, points)
    shares = []
    for workers in (1, 3):
        monkeypatch.setattr(sdm.bench.common.oracles.brute_force.os, "sched_getaffinity", lambda _, n=workers: range(n))
        monkeypatch.setattr(sdm.bench.common.oracles.brute_force, "CHUNK", 90)
        d, _, face = Brute(vertices, faces, progress=shares.append).distance(points)
        np.testing.assert_allclose(d, expected, atol=1e-15)
        assert face.min() >= 0
    assert shares[-1] == 1.0
