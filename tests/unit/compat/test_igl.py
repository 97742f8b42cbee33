"""igl.signed_distance: the same call and answers as libigl's, where its own method is right."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from sdm.compat import igl as ours
from tests.helpers import oracle

igl = pytest.importorskip("igl", reason="needs libigl, an extra")
BALL = trimesh.creation.icosphere(2)
V, F = np.array(BALL.vertices), np.array(BALL.faces, np.int64)
P = np.random.default_rng(0).uniform(-1.5, 1.5, (400, 3))


def closest_on(faces: np.ndarray) -> np.ndarray:
    return P - oracle.closest_on_triangles(P, V[F[faces]])


@pytest.mark.parametrize("kind", ["PSEUDONORMAL", "WINDING_NUMBER", "UNSIGNED", "DEFAULT"])
def test_equals_libigl(kind):
    sign = getattr(igl, f"SIGNED_DISTANCE_TYPE_{kind}")
    theirs = igl.signed_distance(P, V, F, sign)
    found = ours.signed_distance(P, V, F, sign, device="cpu")
    np.testing.assert_allclose(found[0], theirs[0], atol=1e-10)
    np.testing.assert_allclose(found[2], theirs[2], atol=1e-9)
    # On an edge or a corner libigl names any face.
    apart = np.linalg.norm(closest_on(found[1]) - found[2], axis=1)
    assert apart.max() < 1e-9
    for mine, other in zip(found[:3], theirs[:3], strict=True):
        assert (mine.dtype, mine.shape) == (other.dtype, other.shape)
    assert len(found[3]) == len(theirs[3])
    assert ours.signed_distance(P, V, F, kind.lower(), device="cpu")[0].tolist() == found[0].tolist()


@pytest.mark.parametrize("bounds", [(-0.2, 0.3), (0.1, 0.3), (-np.inf, 0.3)])
def test_bounds(bounds):
    theirs = igl.signed_distance(P, V, F, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL, *bounds)
    found = ours.signed_distance(P, V, F, None, *bounds, device="cpu")
    np.testing.assert_array_equal(np.isnan(found[0]), np.isnan(theirs[0]))
    np.testing.assert_array_equal(found[1][np.isnan(found[0])], theirs[1][np.isnan(theirs[0])])
    np.testing.assert_array_equal(found[2][np.isnan(found[0])], theirs[2][np.isnan(theirs[0])])


def test_the_last_mesh_is_kept(monkeypatch):
    built = []

    class Counted(ours.ClosestInFloat64):
        def __init__(self, *args):
            built.append(1)
            super().__init__(*args)

    monkeypatch.setattr(ours, "ClosestInFloat64", Counted)
    ours.forget()
    vertices = V.copy()
    first = ours.signed_distance(P, vertices, F, device="cpu")[0]
    np.testing.assert_array_equal(ours.signed_distance(P, vertices.copy(), F.astype(np.int32), device="cpu")[0], first)
    assert len(built) == 1
    # Whoever writes into an array has another mesh.
    vertices *= 1.5
    np.testing.assert_allclose(ours.signed_distance(1.5 * P, vertices, F, device="cpu")[0], 1.5 * first, rtol=1e-9)
    assert len(built) == 2
    ours.forget()
    ours.signed_distance(P, V, F, device="cpu")
    assert len(built) == 3
