"""Of faces that are equally near, the one that faces the point most is named, then the one with the smallest number."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import cube
from sdm.engine.plan_override import plan_override
from tests.helpers import oracle, strategies

# What the brute force takes for equal, for the same point, and for facing as much.
EQUAL, THERE, FACING = 1e-13, 1e-5, 1e-6


@pytest.fixture(params=["search", "lists"])
def points_method(request):
    """Both ways to query points."""
    with plan_override(points_method=request.param):
        yield


def named(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, closest: np.ndarray) -> np.ndarray:
    """The face (N,) that the rule names for each of points (N,3) and its closest point, by brute force over all."""
    corner = vertices.astype(np.float64)[faces]
    offset = oracle.closest_on_triangles(points[:, None].astype(np.float64), corner[None])
    distance = np.linalg.norm(offset, axis=-1)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    facing = np.abs(np.einsum("nfi,fi->nf", offset, normal)) / np.where(distance > 0, distance, 1)
    facing[distance <= 1e-7] = 0
    there = np.linalg.norm(points[:, None] - offset - closest[:, None], axis=-1) <= THERE
    equal = (distance <= distance.min(1, keepdims=True) + EQUAL) & there
    assert equal.any(1).all()
    most = np.where(equal, facing, -1).max(1, keepdims=True)
    return (equal & (facing >= most - FACING)).argmax(1)


@pytest.mark.usefixtures("points_method")
def test_at_an_acute_edge():
    """Points before the edge of a wedge, nearer to one plane or the other: the named face's normal tells the side."""
    vertices = np.array([[0, 0, 0], [0, 2, 0], [8, 0, 1], [8, 2, 1], [8, 0, -1], [8, 2, -1]], np.float32)
    faces = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4], [0, 4, 2], [1, 3, 5], [2, 4, 3], [3, 4, 5]])
    points = np.array([[-1, 1, z] for z in (-3, -0.5, -0.01, 0.01, 0.5, 3)], np.float32)
    for order in (np.arange(8), np.arange(8)[::-1]):
        mesh = sdm.TriangleMesh(vertices, faces[order])
        values, hit = sdm.signed_distance(mesh, points, return_closest=True, device="cpu")
        assert (values > 0).all()
        np.testing.assert_array_equal(hit.points[:, [0, 2]], 0)
        corner = vertices.astype(np.float64)[faces[order][hit.faces.numpy()]]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (np.einsum("ni,ni->n", normal, points - hit.points.numpy()) > 0).all()
        assert (np.sign(normal[:, 2]) == np.sign(points[:, 2])).all()


@pytest.mark.usefixtures("points_method")
def test_two_faces_that_fold_over_an_edge():
    """Both are equally near to points beyond the edge; the order in which they are given does not matter."""
    vertices = np.array([[0, -1, 0], [0, 1, 0], [1, 0, 0], [1, 0, 2]], np.float32)
    points = np.array([[-0.25, 0, -1], [-1, 0, -0.25], [-1, 0.5, -1e-3]], np.float32)
    for first, second in (([0, 1, 2], [0, 1, 3]), ([0, 1, 3], [0, 1, 2])):
        faces = np.array([first, second])
        _, hit = sdm.signed_distance(sdm.TriangleMesh(vertices, faces), points, return_closest=True, device="cpu")
        flat = first == [0, 1, 2]
        assert hit.faces.tolist() == ([0, 1, 1] if flat else [1, 0, 0])
        assert hit.points.tolist() == [[0, 0, 0], [0, 0, 0], [0, 0.5, 0]]


@pytest.mark.usefixtures("points_method")
def test_the_smallest_number_decides():
    """The centre of a cube is equally near to all its faces; before a corner three pairs face as much."""
    vertices, faces = cube()
    points = np.array([[0, 0, 0], [2, 2, 2], [-2, 2, -3], [0, 0, 1], [0.5, 0.5, 1.5], [1, 1, 1]], np.float32)
    for seed in range(5):
        shuffled = faces[np.random.default_rng(seed).permutation(np.arange(24) % 12)]
        _, hit = sdm.signed_distance(sdm.TriangleMesh(vertices, shuffled), points, return_closest=True, device="cpu")
        assert hit.faces.tolist() == named(vertices, shuffled, points, hit.points.numpy()).tolist()
        assert hit.faces[0] == 0


@pytest.mark.usefixtures("points_method")
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=st.one_of(strategies.soups(), strategies.closed(), strategies.shells()), seed=strategies.seeds)
def test_against_the_brute_force(mesh, seed):
    rng = np.random.default_rng(seed)
    points = (rng.integers(-16, 17, (60, 3)) / 4).astype(np.float32)
    vertices = np.round(mesh.vertices * 4) / 4
    _, hit = sdm.signed_distance(sdm.TriangleMesh(vertices, mesh.faces), points, return_closest=True, device="cpu")
    assert hit.faces.tolist() == named(vertices, mesh.faces, points, hit.points.numpy()).tolist()


@settings(max_examples=24)
@given(mesh=st.one_of(strategies.soups(), strategies.closed(), strategies.shells()), seed=strategies.seeds)
def test_both_ways_name_the_same_faces(mesh, seed):
    """Also where points far apart are equally near."""
    points = (np.random.default_rng(seed).integers(-16, 17, (60, 3)) / 4).astype(np.float32)
    found = []
    for method in ("search", "lists"):
        with plan_override(points_method=method):
            found.append(sdm.signed_distance(sdm.TriangleMesh(*mesh), points, return_closest=True, device="cpu")[1])
    assert found[0].faces.tolist() == found[1].faces.tolist()
    assert found[0].points.tolist() == found[1].points.tolist()


def nearly_flat_cone(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Faces around a corner whose |cos| before it follow each other by less than FACING, and by more all together."""
    rng = np.random.default_rng(seed)
    angle = np.arange(7) * 2 * np.pi / 7
    rim = np.stack([np.cos(angle), np.sin(angle), -0.5 - rng.uniform(0, 8e-6, 7)], 1)
    faces = np.array([[0, 1 + k, 1 + (k + 1) % 7] for k in range(7)])
    return np.concatenate([np.zeros((1, 3)), rim]).astype(np.float32), rng.permutation(faces)


@pytest.mark.usefixtures("points_method")
@pytest.mark.parametrize("seed", range(10))
def test_the_order_of_looks_does_not_matter(seed):
    """Also where the first and the last of some faces differ in |cos|, and none from the next."""
    vertices, faces = nearly_flat_cone(seed)
    points = np.array([[0, 0, 0.5], [0, 0, 1], [0, 0, 2]], np.float32)
    _, hit = sdm.signed_distance(
        sdm.TriangleMesh(vertices, faces), points, return_closest=True, sign="none", device="cpu"
    )
    assert hit.points.tolist() == [[0, 0, 0]] * 3
    assert hit.faces.tolist() == named(vertices, faces, points, hit.points.numpy()).tolist()


@pytest.mark.parametrize("seed", range(10))
def test_the_order_of_looks_does_not_matter_to_maps(seed):
    """Maps compare in float32: no face before the named one faces clearly as much, and it nearly as much as any."""
    vertices, faces = nearly_flat_cone(seed)
    grid = sdm.Grid((0, 0, 0.25), (0.25,) * 3, (1, 1, 8))
    with plan_override(method="cells"):
        _, hit = sdm.signed_distance_map(
            sdm.TriangleMesh(vertices, faces), grid, return_closest=True, sign="none", device="cpu"
        )
    corner = vertices.astype(np.float64)[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    cos = np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1)
    for face in set(hit.faces.reshape(-1).tolist()):
        assert cos[face] >= cos.max() - 1.3 * FACING
        assert not (cos[:face] >= cos.max() - 0.7 * FACING).any()
