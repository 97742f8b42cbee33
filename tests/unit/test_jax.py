"""Distances and maps for JAX: the bits that torch gives, inside `jit`, with gradients, on either device."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch

import sdm
from sdm.core.demo_mesh import demo_mesh
from sdm.errors import GridError, MeshError, SDMError

jax = pytest.importorskip("jax", reason="needs JAX, an extra")

VERTICES, FACES = demo_mesh(rings=21, segments=10, cap_rings=2).numpy()
POINTS = np.random.default_rng(0).normal(0, 3.0, (200, 3)).astype(np.float32)
GRID = sdm.Grid((-4, -4, -1), (1.0, 0.9, 0.8), (9, 10, 8))


@pytest.fixture(autouse=True)
def there(device) -> Iterator[None]:
    """JAX works where torch does."""
    try:
        chosen = jax.devices("gpu" if device == "cuda" else "cpu")[0]
    except RuntimeError as error:
        pytest.skip(f"JAX has no such device: {error}")
    with jax.default_device(chosen):
        yield


@pytest.fixture
def moving(device) -> tuple[torch.Tensor, torch.Tensor, sdm.TriangleMesh]:
    """Vertices and points of torch to which gradients flow, and the mesh."""
    vertices = torch.tensor(VERTICES, device=device, requires_grad=True)
    points = torch.tensor(POINTS, device=device, requires_grad=True)
    return vertices, points, sdm.TriangleMesh(vertices, torch.tensor(FACES, device=device))


def same_gradient(found, wanted: torch.Tensor) -> None:
    """Sums over faces are in any order on a GPU."""
    if wanted.is_cuda:
        np.testing.assert_allclose(np.asarray(found), wanted.cpu(), rtol=1e-4, atol=1e-4)
    else:
        np.testing.assert_array_equal(np.asarray(found), wanted)


def test_points(moving):
    from sdm.jax import signed_distance

    vertices, points, mesh = moving
    found = jax.jit(signed_distance)(VERTICES, FACES, POINTS.reshape(20, 10, 3))
    wanted = sdm.signed_distance(mesh, points)
    assert (wanted < 0).any()
    np.testing.assert_array_equal(np.asarray(found).ravel(), wanted.detach().cpu())
    unsigned = signed_distance(VERTICES, FACES, POINTS, sign="none")
    np.testing.assert_array_equal(np.asarray(unsigned), wanted.detach().abs().cpu())
    (wanted**2).sum().backward()
    loss = jax.grad(lambda v, p: (signed_distance(v, FACES, p) ** 2).sum(), (0, 1))
    to_vertices, to_points = jax.jit(loss)(VERTICES, POINTS)
    same_gradient(to_vertices, vertices.grad)
    np.testing.assert_array_equal(np.asarray(to_points), points.grad.cpu())


def test_maps(moving):
    from sdm.jax import signed_distance_map

    vertices, _, mesh = moving
    found = jax.jit(lambda v: signed_distance_map(v, FACES, GRID))(VERTICES)
    wanted = sdm.signed_distance_map(mesh, GRID).values
    np.testing.assert_array_equal(np.asarray(found), wanted.detach().cpu())
    wanted.clamp(max=1.0).sum().backward()
    loss = jax.grad(lambda v: jax.numpy.minimum(signed_distance_map(v, FACES, GRID), 1.0).sum())
    same_gradient(loss(VERTICES), vertices.grad)


def test_batches_and_nothing():
    from sdm.jax import signed_distance

    alone = signed_distance(VERTICES, FACES, POINTS)
    found = jax.vmap(lambda points: signed_distance(VERTICES, FACES, points))(POINTS.reshape(4, 50, 3))
    np.testing.assert_array_equal(np.asarray(found).ravel(), np.asarray(alone))
    assert signed_distance(VERTICES, FACES, np.zeros((0, 3))).shape == (0,)


def test_mistakes():
    from sdm.jax import signed_distance, signed_distance_map

    with pytest.raises(MeshError, match=r"the points have shape \(200, 2\)"):
        signed_distance(VERTICES, FACES, POINTS[:, :2])
    with pytest.raises(MeshError, match=r"the faces have shape \(0, 3\)"):
        signed_distance(VERTICES, FACES[:0], POINTS)
    with pytest.raises(SDMError, match="the sign 'flood' is not there for JAX"):
        signed_distance(VERTICES, FACES, POINTS, sign="flood")
    with pytest.raises(GridError, match="says nothing without a mesh"):
        signed_distance_map(VERTICES, FACES, 32)
    with pytest.raises((RuntimeError, ValueError), match="uses vertex 100"):
        signed_distance(VERTICES, np.where(FACES == 0, 100_000, FACES), POINTS).block_until_ready()
