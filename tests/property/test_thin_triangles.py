"""Near-degenerate triangles, alone and in T-junctions: none hides what is nearer, whatever is asked and how."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.degenerate_meshes import filled_t_junctions, thin_soup
from sdm.bench.common.oracles import rational
from sdm.bench.fuzz.edge_lines import grid_in_line, points_in_line
from sdm.engine.plan_override import plan_override
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of

# Three corners on one turned line, as near as float32 has it, of two triangles; a point between theirs and beyond.
LINE = [
    [-1.447624921798706, 0.4282739758491516, 1.7468687295913696],
    [-0.8597241640090942, -0.7521378397941589, 1.4085214138031006],
    [-1.0241400003433228, -0.42201700806617737, 1.5031455755233765],
    [-1.0208276510238647, -0.42866751551628113, 1.5012394189834595],
    [-0.6330865621566772, -1.2071902751922607, 1.2780874967575073],
    [-0.6884263753890991, -1.0960768461227417, 1.3099365234375],
]
BETWEEN = [[-1.0409536361694336, -0.388257771730423, 1.5128222703933716]]
# Soups that every kind of map got wrong while such triangles had the inside tests of all others, beside any others.
MAP_SEEDS = [*range(50), 134, 397, 492, 586, 593, 615, 623, 640, 670, 690]
BATCH_SEEDS = [*range(25), 63, 106, 107, 128, 156, 169, 310, 383, 425, 454]


@pytest.fixture(params=["search", "lists"])
def points_method(request):
    """Both ways to query points."""
    with plan_override(points_method=request.param):
        yield


@pytest.fixture(params=["cells", "search", "auto"])
def map_method(request):
    """All ways to compute maps."""
    with plan_override(method=request.param):
        yield


def loose(corner: np.ndarray) -> strategies.Arrays:
    return strategies.Arrays(corner.reshape(-1, 3), np.arange(corner.size // 3, dtype=np.int32).reshape(-1, 3))


@pytest.mark.usefixtures("points_method")
@pytest.mark.parametrize("faces", [[[0, 1, 2]], [[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]])
def test_a_point_beyond_a_collinear_triangle(faces):
    vertices, faces, points = np.array(LINE, np.float32), np.array(faces), np.array(BETWEEN, np.float32)
    value = sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, device="cpu")
    truth = rational.distance(vertices, faces, points)
    assert truth < 2e-7
    np.testing.assert_allclose(value.abs(), truth, rtol=0, atol=4 * ROUNDING * 1.7)


@pytest.mark.usefixtures("points_method")
def test_points_on_a_filled_t_junction():
    rng = np.random.default_rng(3)
    for seed in range(10):
        vertices, faces = filled_t_junctions(12, seed)
        begin, end = vertices[[0, 3]].astype(np.float64)
        points = (begin + rng.uniform(-0.2, 1.2, (300, 1)) * (end - begin)).astype(np.float32)
        index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
        assert index.closed
        assert_exact(vertices, faces, points, index.signed_distance(points))


@pytest.mark.usefixtures("map_method")
def test_maps_of_a_filled_t_junction():
    rng = np.random.default_rng(3)
    for seed in range(4):
        vertices, faces = filled_t_junctions(12, seed)
        # An axis along the split edge.
        grid = grid_in_line(vertices[[[0, 3, 1]]], rng, 13)
        field = sdm.signed_distance_map(sdm.TriangleMesh(vertices, faces), grid, device="cpu")
        assert_exact(vertices, faces, grid.points().reshape(-1, 3).numpy(), field.values)


@pytest.mark.usefixtures("points_method")
def test_points_about_thin_soups():
    for seed in range(150):
        rng = np.random.default_rng(seed)
        corner = thin_soup(rng, int(rng.integers(1, 6)))
        mesh, points = loose(corner), points_in_line(corner, rng, 60)
        assert_exact(*mesh, points, sdm.signed_distance(sdm.TriangleMesh(*mesh), points, device="cpu"))


@pytest.mark.usefixtures("map_method")
def test_maps_of_thin_soups():
    for seed in MAP_SEEDS:
        rng = np.random.default_rng(seed)
        corner = thin_soup(rng, int(rng.integers(1, 6)))
        mesh, grid = loose(corner), grid_in_line(corner, rng, 9)
        field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu")
        assert_exact(*mesh, grid.points().reshape(-1, 3).numpy(), field.values)


def test_batches_and_updates_of_thin_soups():
    for seed in BATCH_SEEDS:
        rng = np.random.default_rng(seed)
        corners = np.stack([thin_soup(rng, 3) for _ in range(3)])
        meshes = [loose(corner) for corner in corners]
        grid = grid_in_line(corners[0], rng, 9)
        points = grid.points().reshape(-1, 3).numpy()
        vertices, faces = np.stack([mesh.vertices for mesh in meshes]), meshes[0].faces
        maps = sdm.signed_distance_maps(vertices, faces, grid, device="cpu")
        index = sdm.MeshIndex(sdm.TriangleMesh(*meshes[1]), "cpu")
        index.update(meshes[0].vertices)
        assert_exact(*meshes[0], points, index.signed_distance(points))
        assert torch.equal(index.signed_distance_map(grid).values, maps[0])
        for mesh, values in zip(meshes, maps, strict=True):
            assert_exact(*mesh, points, values)


def test_closest_points_and_gradients_of_thin_soups():
    for seed in range(100):
        rng = np.random.default_rng(seed)
        corner = thin_soup(rng, int(rng.integers(1, 6)))
        mesh, points = loose(corner), points_in_line(corner, rng, 40)
        at = torch.from_numpy(points).requires_grad_()
        values, hit = sdm.signed_distance(sdm.TriangleMesh(*mesh), at, return_closest=True, device="cpu")
        assert_exact(*mesh, points, values)
        limit = 4 * ROUNDING * scale_of(*mesh, points)
        closest, weights = hit.points.detach().double().numpy(), hit.barycentric.detach().double().numpy()
        reach = np.linalg.norm(points - closest, axis=1)
        assert (np.abs(reach - values.detach().abs().double().numpy()) <= limit).all()
        placed = (weights[:, None] @ corner[hit.faces.numpy()].astype(np.float64))[:, 0]
        assert (np.abs(placed - closest).max(1) <= limit).all()
        # Away from the surface, the gradient is the way from the closest point.
        (gradient,) = torch.autograd.grad(values.sum(), at)
        away = reach > 1e-2
        way = np.sign(values.detach().numpy())[away, None] * (points - closest)[away] / reach[away, None]
        np.testing.assert_allclose(gradient.numpy()[away], way, atol=1e-4)


@st.composite
def thin_meshes(draw: st.DrawFn) -> strategies.Arrays:
    rng = np.random.default_rng(draw(strategies.seeds))
    mesh = loose(thin_soup(rng, draw(st.integers(1, 5))))
    offset = draw(strategies.offsets) * np.array([1.0, -0.7, 0.3])
    return strategies.Arrays(((mesh.vertices + offset) * draw(strategies.scales)).astype(np.float32), mesh.faces)


@pytest.mark.usefixtures("points_method")
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=thin_meshes(), seed=strategies.seeds)
def test_any_thin_mesh(mesh: strategies.Arrays, seed: int):
    points = points_in_line(mesh.vertices[mesh.faces], np.random.default_rng(seed), 40)
    values = sdm.signed_distance(sdm.TriangleMesh(*mesh), points, device="cpu")
    assert_exact(*mesh, points, values)
    few = slice(0, 4)
    truth = rational.distance(*mesh, points[few])
    limit = 4 * ROUNDING * scale_of(*mesh, points[few])
    assert (np.abs(values[few].abs().double().numpy() - truth) <= limit).all()
