"""Closest points of maps: at the distance that the map tells, on the face that is named, and those that points get."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.grids import turned_around
from sdm.bench.common.meshes import Case, generated_names, load_case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.engine import map_closest
from sdm.engine.plan_override import plan_override
from sdm.runtime.graphs import unverified
from sdm.topology.face_pairing import neighbours
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, scale_of

SHAPE = (19, 12, 21)
METHODS = ("cells", "search")


@lru_cache(maxsize=1)
def brute_force(name: str) -> tuple[Brute, np.ndarray]:
    """The brute force of a generated mesh, and its distances on the grid of `SHAPE`."""
    case = load_case(name)
    grid = sdm.Grid.around(sdm.TriangleMesh(case.vertices, case.faces), SHAPE)
    brute = Brute(case.vertices, case.faces)
    return brute, brute.distance(grid.points().reshape(-1, 3).numpy())[0]


def agrees(
    case: Case, grid: sdm.Grid, device: str = "cpu", known: tuple[Brute, np.ndarray] | None = None, **options
) -> tuple[float, sdm.SDM]:
    """Check all voxels; the share of those whose face is the one that points get, and the map."""
    index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces, case.name), device, warn=False)
    with plan_override(**options):
        alone = index.signed_distance_map(grid)
        field, hit = index.signed_distance_map(grid, return_closest=True)
    assert torch.equal(field.values, alone.values)
    assert field.ambiguous_voxels == alone.ambiguous_voxels
    assert hit.points.shape == hit.barycentric.shape == (*grid.shape, 3)
    assert hit.faces.shape == grid.shape

    points = grid.points().reshape(-1, 3).numpy()
    closest = hit.points.reshape(-1, 3).cpu().numpy().astype(np.float64)
    faces, weights = hit.faces.reshape(-1).cpu().numpy(), hit.barycentric.reshape(-1, 3).cpu().double().numpy()
    assert ((faces >= 0) & (faces < len(case))).all()
    limit = 6 * ROUNDING * scale_of(case.vertices, case.faces, points)
    reach = np.linalg.norm(points - closest, axis=1)
    assert (np.abs(reach - np.abs(field.numpy().reshape(-1))) <= limit).all()
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(1), 1, atol=4e-7)
    corner = case.vertices[case.faces[faces]].astype(np.float64)
    assert (np.abs((weights[:, None] @ corner)[:, 0] - closest).max(1) <= limit).all()
    brute = Brute(case.vertices, case.faces) if known is None else known[0]
    expected = brute.distance(points)[0] if known is None else known[1]
    assert (np.abs(reach - expected) <= limit).all()
    # The named face is as near as any.
    assert (np.abs(brute.distance_to_face(points, faces) - expected) <= limit).all()
    _, by_points = index.signed_distance(points, return_closest=True)
    return float((by_points.faces.reshape(-1).cpu().numpy() == faces).mean()), field


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", generated_names())
def test_every_kind_of_mesh(name, method):
    case = load_case(name)
    grid = sdm.Grid.around(sdm.TriangleMesh(case.vertices, case.faces), SHAPE)
    share, _ = agrees(case, grid, known=brute_force(name), method=method)
    # The others are equally near, to rounding.
    assert share == 1 if method == "search" else share > 0.85


@pytest.mark.gpu
@pytest.mark.parametrize("name", generated_names())
def test_every_kind_of_mesh_on_a_gpu(name):
    case = load_case(name)
    grid = sdm.Grid.around(sdm.TriangleMesh(case.vertices, case.faces), (24, 20, 22))
    for method in METHODS:
        assert agrees(case, grid, "cuda", method=method)[0] > 0.85


meshes = st.one_of(strategies.soups(), strategies.slivers(), strategies.closed(), strategies.shells())


@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(mesh=meshes, seed=strategies.seeds, method=st.sampled_from(METHODS))
def test_random_meshes(mesh, seed, method):
    rng = np.random.default_rng(seed)
    # On the lattice of the vertices, where ties are exact, or beside it.
    origin = rng.integers(-4, 0, 3) + rng.choice([0.0, 0.37])
    grid = sdm.Grid(origin, rng.choice([0.5, 1.0, 0.83], 3), (9, 8, 10))
    agrees(Case("random", mesh.vertices, mesh.faces, frozenset()), grid, method=method)


def test_as_points_where_few_are_equally_near():
    """Of a closed surface without large flat parts nearly all faces are those that points get."""
    case = load_case("torus-2000")
    grid = sdm.Grid.around(sdm.TriangleMesh(case.vertices, case.faces), 40)
    assert agrees(case, grid, method="cells")[0] > 0.999


def test_at_an_acute_edge_the_normal_tells_the_side():
    vertices = np.array([[0, 0, 0], [0, 2, 0], [8, 0, 1], [8, 2, 1], [8, 0, -1], [8, 2, -1]], np.float32)
    faces = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4], [0, 4, 2], [1, 3, 5], [2, 4, 3], [3, 4, 5]])
    grid = sdm.Grid((-3, 0.5, -3), (0.5, 0.5, 0.41), (5, 3, 16))
    for order in (np.arange(8), np.arange(8)[::-1]):
        index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces[order]), "cpu", warn=False)
        with plan_override(method="cells"):
            field, hit = index.signed_distance_map(grid, return_closest=True)
        assert (field.values > 0).all()
        corner = torch.from_numpy(vertices).double()[torch.from_numpy(faces[order].copy())]
        normals = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert ((hit.of_faces(normals) * hit.directions).sum(-1) > 0).all()


@pytest.mark.parametrize(
    "options",
    [{"pool_entries": 4096}, {"cell": 16}, {"most_regions": 1}, {"levels_left_out": 2}, {"slice_factors": (1,)}],
    ids=lambda options: next(iter(options)),
)
def test_however_it_is_planned(options):
    case = load_case("torus-2000")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    for grid in (sdm.Grid.around(mesh, (24, 33, 18)), turned_around(case, 24)):
        assert agrees(case, grid, method="cells", **options)[0] > 0.99


def test_thick_slices_have_the_values_of_the_map():
    case = load_case("torus-20000")
    grid = sdm.Grid.around(sdm.TriangleMesh(case.vertices, case.faces), (48, 48, 5))
    agrees(case, grid)


def test_slabs_make_a_whole(monkeypatch):
    case = load_case("torus-2000")
    grid = sdm.Grid.around(sdm.TriangleMesh(case.vertices, case.faces), (70, 9, 11))
    index = sdm.MeshIndex((case.vertices, case.faces), "cpu")
    field, whole = index.signed_distance_map(grid, return_closest=True)
    monkeypatch.setattr(map_closest, "LARGEST_SLAB", 1)
    again, parts = index.signed_distance_map(grid, return_closest=True)
    assert torch.equal(field.values, again.values)
    assert torch.equal(whole.faces, parts.faces)
    assert torch.equal(whole.points, parts.points)
    assert torch.equal(whole.barycentric, parts.barycentric)


def test_what_is_recorded_does_the_same():
    """On a GPU the work is queued from the structure's memory alone; here it is done once in that way."""
    case = load_case("open hemisphere")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    index = sdm.MeshIndex(mesh, "cpu", warn=False)
    grid = sdm.Grid.around(mesh, (17, 12, 14))
    found = map_closest.closest_map(index.mesh, index._structure, grid)
    around = neighbours(mesh.faces, mesh.vertices.shape[0])
    (block,) = index._structure.memory
    again = map_closest._queue_recordable(index._structure.sizes, grid, unverified, block, mesh.faces, around)
    for one, other in zip(found, again, strict=True):
        assert torch.equal(one, other)


def test_voxels_with_other_values_than_the_map_are_asked_about_as_points(monkeypatch):
    plain = map_closest._queue

    def damaged(*args, **kwargs):
        found = plain(*args, **kwargs)
        for whole in (found.values, found.points, found.barycentric, found.faces):
            whole[3:6, 2:4] = 0
        return found

    case = load_case("open hemisphere")
    grid = turned_around(case, 20)
    monkeypatch.setattr(map_closest, "_queue", damaged)
    with pytest.raises(AssertionError):
        agrees(case, grid)
    monkeypatch.setitem(map_closest.COMPARED, "cpu", True)
    agrees(case, grid)
