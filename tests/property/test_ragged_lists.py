"""Maps and distances of random lists of meshes that differ: bit for bit those of single calls."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import cube, sphere, torus
from sdm.engine.plan_override import plan_override
from sdm.engine.ragged.joint_maps import MapJob, ragged_maps
from tests.helpers.same_bits import assert_same_bits


def random_mesh(rng: np.random.Generator) -> sdm.TriangleMesh:
    """Closed, open or dirty; of a few triangles or of a thousand; somewhere."""
    shapes = cube, lambda: sphere(int(rng.integers(4, 24))), lambda: torus(int(rng.integers(20, 900)))
    vertices, faces = shapes[rng.integers(3)]()
    vertices = (vertices * rng.uniform(0.5, 2.0, 3) + rng.normal(size=3)).astype(np.float32)
    dirt = rng.integers(6)
    if dirt == 0:  # holes
        faces = faces[rng.random(len(faces)) > rng.choice([0.02, 0.3])]
    elif dirt == 1:  # every triangle with vertices of its own, as in an STL file
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    elif dirt == 2:  # turned, repeated and flat ones
        faces = np.concatenate(
            [np.where(rng.random((len(faces), 1)) < 0.1, faces[:, ::-1], faces), faces[:2, [0, 1, 1]]]
        )
    return sdm.TriangleMesh(vertices, faces if len(faces) else np.array([[0, 1, 2]]))


def random_grid(rng: np.random.Generator, mesh: sdm.TriangleMesh) -> sdm.Grid:
    kind = rng.integers(4)
    if kind == 0:
        return sdm.Grid.around(mesh, spacing=tuple(rng.uniform(0.08, 0.4, 3)))
    grid = sdm.Grid.around(mesh, tuple(rng.integers(1, 24, 3).tolist()) if kind == 1 else int(rng.integers(2, 36)))
    if kind < 3:
        return grid
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return sdm.Grid(grid.origin, grid.spacing, grid.shape, turn)


def assert_same(found: list[sdm.SDM], meshes: list[sdm.TriangleMesh], grids: list[sdm.Grid]) -> None:
    assert len(found) == len(meshes)
    for i, (field, mesh, grid) in enumerate(zip(found, meshes, grids, strict=True)):
        alone = sdm.signed_distance_map(mesh, grid, device="cpu")
        assert field.grid == grid
        assert_same_bits(field.values, alone.values, (i, mesh, grid))
        assert field.ambiguous_voxels == alone.ambiguous_voxels, (i, mesh, grid)


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 7),
    options=st.sampled_from(
        [
            {},
            {"cell": 16},
            {"shares": (4, 2), "split_length": 3},
            {"levels_left_out": 1, "most_regions": 2},
            {"slice_factors": (1,)},
        ]
    ),
    max_bytes=st.sampled_from([None, 1, 1 << 20]),
)
def test_maps_are_those_of_single_calls(seed, count, options, max_bytes):
    rng = np.random.default_rng(seed)
    meshes = [random_mesh(rng) for _ in range(count)]
    grids = [random_grid(rng, mesh) for mesh in meshes]
    with plan_override(**options):
        assert_same(sdm.signed_distance_maps(meshes, grids, device="cpu", max_bytes=max_bytes), meshes, grids)


def assert_same_closest(hit: sdm.Closest, other: sdm.Closest, of_vertices: torch.Tensor, where: object) -> None:
    for one, two in (
        (hit.points, other.points),
        (hit.faces, other.faces),
        (hit.barycentric, other.barycentric),
        (hit.directions, other.directions),
        (hit.interpolate(of_vertices), other.interpolate(of_vertices)),
    ):
        assert torch.equal(one.nan_to_num(), two.nan_to_num()), where


SIGNS = [
    {"sign": "none"},
    {"sign": "flood"},
    {"sign": "flood", "hole_size": 0.3},
    {"compare_signs": True},
    {"sign": "none", "compare_signs": True, "hole_size": 0.2},
    {"orient": "auto"},
    {"orient": "parts"},
    {"orient": "parts", "sign": "flood", "compare_signs": True},
]


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@settings(deadline=None, max_examples=10)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(2, 5),
    options=st.sampled_from(SIGNS),
    closest=st.booleans(),
    max_bytes=st.sampled_from([None, 1 << 20]),
)
def test_maps_by_every_method_are_those_of_single_calls(seed, count, options, closest, max_bytes):
    rng = np.random.default_rng(seed)
    meshes = [random_mesh(rng) for _ in range(count)]
    grids = [sdm.Grid.around(mesh, int(rng.integers(3, 14))) for mesh in meshes]
    asked = {**options, "return_closest": closest, "device": "cpu"}
    found = sdm.signed_distance_maps(meshes, grids, max_bytes=max_bytes, **asked)
    for i, (made, mesh, grid) in enumerate(zip(found, meshes, grids, strict=True)):
        alone = sdm.signed_distance_map(mesh, grid, **asked)
        field, own = (made[0], alone[0]) if closest else (made, alone)
        assert_same_bits(field.values, own.values, (i, mesh, grid))
        for name in ("ambiguous_voxels", "sign", "hole_size", "sign_disagreements"):
            assert getattr(field, name) == getattr(own, name), (i, name)
        if closest:
            assert_same_closest(made[1], alone[1], mesh.vertices, (i, mesh, grid))


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@settings(deadline=None, max_examples=10)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 4),
    sign=st.sampled_from(["winding", "none"]),
    closest=st.booleans(),
    method=st.sampled_from(["search", "lists"]),
    many=st.sampled_from([60, 2500]),
    max_bytes=st.sampled_from([None, 1 << 21]),
)
def test_distances_are_those_of_single_calls(seed, count, sign, closest, method, many, max_bytes):
    rng = np.random.default_rng(seed)
    meshes = [random_mesh(rng) for _ in range(count)]
    points = [torch.from_numpy(rng.normal(size=(rng.integers(0, many), 3)).astype(np.float32)) for _ in meshes]
    for i, at in enumerate(points):
        at[: i % 3] = np.nan
    asked = {"device": "cpu", "sign": sign, "return_closest": closest}
    with plan_override(points_method=method):
        found = sdm.signed_distances(meshes, points, max_bytes=max_bytes, **asked)
    for i, (made, mesh, at) in enumerate(zip(found, meshes, points, strict=True)):
        alone = sdm.signed_distance(mesh, at, **asked)
        values, own = (made[0], alone[0]) if closest else (made, alone)
        assert torch.equal(values.nan_to_num(), own.nan_to_num()), (i, mesh)
        if closest:
            assert_same_closest(made[1], alone[1], mesh.vertices, (i, mesh))


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
def test_a_huge_mesh_beside_tiny_ones():
    rng = np.random.default_rng(5)
    meshes = [sdm.TriangleMesh(*cube()), sdm.TriangleMesh(*sphere(150)), *(random_mesh(rng) for _ in range(4))]
    grids = [sdm.Grid.around(mesh, 40 if i == 0 else 17) for i, mesh in enumerate(meshes)]
    assert_same(sdm.signed_distance_maps(meshes, grids, device="cpu"), meshes, grids)


def test_what_found_no_room_is_searched():
    meshes = [sdm.TriangleMesh(*sphere(n)) for n in (9, 20, 14)]
    grids = [sdm.Grid.around(mesh, n) for mesh, n in zip(meshes, (20, 33, 18), strict=True)]
    with plan_override(pool_entries=64 * 40):
        found = sdm.signed_distance_maps(meshes, grids, device="cpu")
    for field, mesh, grid in zip(found, meshes, grids, strict=True):
        alone = sdm.signed_distance_map(mesh, grid, device="cpu")
        torch.testing.assert_close(field.values, alone.values, atol=1e-6, rtol=0)


@pytest.mark.parametrize("shares", [[(1, 1), (2, 1), (2, 2)], [(4, 2), (8, 4), (8, 2)], [(16, 2), (32, 4), (16, 4)]])
def test_lists_made_in_other_shares_each(shares):
    meshes = [sdm.TriangleMesh(*shape) for shape in (sphere(20), torus(3000), sphere(13))]
    jobs = [MapJob(i, mesh, sdm.Grid.around(mesh, 24 + i)) for i, mesh in enumerate(meshes)]
    alone = []
    for job, own in zip(jobs, shares, strict=True):
        with plan_override(shares=own):
            # Kept by the job, so that the others' do not matter to it.
            assert (job.plan[1].region_shares, job.plan[1].cell_shares) == own
            alone.append(sdm.signed_distance_map(job.mesh, job.grid, device="cpu"))
    joint = ragged_maps(jobs)
    for place, field in enumerate(alone):
        assert_same_bits(joint.values(place), field.values, place)


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@settings(deadline=None, max_examples=15)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(2, 6),
    split_length=st.sampled_from([1, 3, 17, 130, None]),
    list_bricks=st.booleans(),
)
def test_lists_in_other_splits_than_alone(seed, count, split_length, list_bricks):
    """As on a GPU, where the mesh with the fewest triangles says how the lists of all are split, and others' shares
    of them are theirs: meshes of a few triangles beside some of thousands, on coarse grids and fine ones."""
    rng = np.random.default_rng(seed)
    alone, jobs = [], []
    for number in range(count):
        large = sphere(int(rng.integers(30, 60))) if rng.random() < 0.3 else None
        mesh = random_mesh(rng) if large is None else sdm.TriangleMesh(*large)
        job = MapJob(number, mesh, random_grid(rng, mesh))
        own = {
            "shares": [(1, 1), (2, 1), (2, 2)][rng.integers(3)],
            "split_length": [2, 5, 40, None][rng.integers(4)],
            "levels_left_out": int(rng.integers(2)),
        }
        with plan_override(method="cells", slice_factors=(1,), list_bricks=list_bricks, **own):
            # Kept by the job, so that the others' do not matter to it.
            assert job.plan[0].triangles == len(mesh.faces)
            alone.append(sdm.signed_distance_map(mesh, job.grid, device="cpu").values)
        jobs.append(job)
    for turned in (False, True):
        some = [job for job in jobs if job.turned == turned]
        if some:
            with plan_override(slice_factors=(1,), split_length=split_length):
                joint = ragged_maps(some)
            for place, job in enumerate(some):
                if place not in joint.left:
                    assert_same_bits(joint.values(place), alone[job.number], (job.number, job.mesh, job.grid))
