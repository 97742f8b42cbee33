"""Lists of meshes that differ on a GPU: bit for bit what single calls give, however they are cut into chunks.

Points of open meshes with as few waits, however many there are.
"""

from __future__ import annotations

import warnings
from unittest import mock

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import torn
from sdm.bench.common.meshes import torus
from sdm.engine.structure import sizes
from tests.helpers.same_bits import assert_same_bits, difference
from tests.property.test_open_point_lists import KINDS, kinds_of, points_around, torn_mesh
from tests.property.test_ragged_lists import SIGNS, assert_same_closest, random_grid, random_mesh

pytestmark = [pytest.mark.gpu, pytest.mark.filterwarnings("ignore::sdm.SDMWarning")]


def what_differs(
    i: int,
    meshes: list[sdm.TriangleMesh],
    grids: list[sdm.Grid],
    max_bytes: int | None,
    listed: torch.Tensor,
    alone: torch.Tensor,
) -> str:
    """Difference of a list's map from a single call's, and whether either call, made again, gives something else."""
    again = {
        "alone again": (sdm.signed_distance_map(meshes[i], grids[i]).values, alone),
        "in the list again": (sdm.signed_distance_maps(meshes, grids, max_bytes=max_bytes)[i].values, listed),
        "in a list of its own": (sdm.signed_distance_maps(meshes[i : i + 1], grids[i : i + 1])[0].values, alone),
    }
    others = [f"{name}: {difference(*pair) or 'the same as before'}" for name, pair in again.items()]
    pair = f"mesh {i} of {len(meshes)}, {meshes[i]} on {grids[i]}: {difference(listed, alone)}"
    return "; ".join([pair, *others])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("max_bytes", [None, 1 << 22])
def test_maps_and_distances_are_those_of_single_calls(seed: int, max_bytes: int | None) -> None:
    rng = np.random.default_rng(seed)
    meshes = [random_mesh(rng).to("cuda") for _ in range(12)]
    grids = [random_grid(rng, mesh) for mesh in meshes]
    found = sdm.signed_distance_maps(meshes, grids, max_bytes=max_bytes)
    for i, (field, mesh, grid) in enumerate(zip(found, meshes, grids, strict=True)):
        alone = sdm.signed_distance_map(mesh, grid)
        if difference(field.values, alone.values):
            pytest.fail(what_differs(i, meshes, grids, max_bytes, field.values, alone.values))
        assert field.ambiguous_voxels == alone.ambiguous_voxels, (i, mesh, grid)
    points = [torch.randn(int(rng.integers(0, 9000)), 3, device="cuda") for _ in meshes]
    for values, mesh, at in zip(sdm.signed_distances(meshes, points, max_bytes=max_bytes), meshes, points, strict=True):
        assert_same_bits(values, sdm.signed_distance(mesh, at), mesh)


@pytest.mark.parametrize("options", SIGNS, ids=str)
@pytest.mark.parametrize("closest", [False, True])
def test_every_method_and_closest_points_are_those_of_single_calls(options: dict, closest: bool) -> None:
    rng = np.random.default_rng(3)
    meshes = [random_mesh(rng).to("cuda") for _ in range(8)]
    grids = [sdm.Grid.around(mesh, int(rng.integers(3, 30))) for mesh in meshes]
    asked = {**options, "return_closest": closest}
    for made, mesh, grid in zip(sdm.signed_distance_maps(meshes, grids, **asked), meshes, grids, strict=True):
        alone = sdm.signed_distance_map(mesh, grid, **asked)
        field, own = (made[0], alone[0]) if closest else (made, alone)
        assert_same_bits(field.values, own.values, (mesh, grid))
        assert field.ambiguous_voxels == own.ambiguous_voxels, (mesh, grid)
        assert field.sign_disagreements == own.sign_disagreements
        if closest:
            assert_same_closest(made[1], alone[1], mesh.vertices, (mesh, grid))


@pytest.mark.parametrize("sign", ["winding", "none"])
def test_closest_points_of_point_lists_are_those_of_single_calls(sign: str) -> None:
    rng = np.random.default_rng(4)
    meshes = [random_mesh(rng).to("cuda") for _ in range(12)]
    points = [torch.randn(int(rng.integers(0, 9000)), 3, device="cuda") for _ in meshes]
    asked = {"sign": sign, "return_closest": True}
    for (values, hit), mesh, at in zip(sdm.signed_distances(meshes, points, **asked), meshes, points, strict=True):
        alone, own = sdm.signed_distance(mesh, at, **asked)
        assert_same_bits(values, alone, mesh)
        assert_same_closest(hit, own, mesh.vertices, mesh)


def test_meshes_of_the_host_are_taken_there() -> None:
    meshes = [random_mesh(np.random.default_rng(seed)) for seed in range(5)]
    for field, mesh in zip(sdm.signed_distance_maps(meshes, 20, device="cuda"), meshes, strict=True):
        assert field.device.type == "cuda"
        assert_same_bits(field.values, sdm.signed_distance_map(mesh, 20, device="cuda").values, mesh)


def test_a_face_out_of_range_is_named_by_its_mesh() -> None:
    good = random_mesh(np.random.default_rng(0)).to("cuda")
    bad = sdm.TriangleMesh(good.vertices, good.faces + 1, check=False)
    with pytest.raises(sdm.MeshError, match=r"^mesh 2: a face uses vertex"):
        sdm.signed_distance_maps([good, good, bad, good], 16)


@pytest.mark.parametrize("limits", KINDS, ids=str)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("max_bytes", [None, 1 << 22])
def test_points_of_all_kinds_are_those_of_single_calls(
    limits: dict[str, int], seed: int, max_bytes: int | None
) -> None:
    rng = np.random.default_rng(seed)
    meshes = [(torn_mesh if i % 3 else random_mesh)(rng).to("cuda") for i in range(12)]
    with mock.patch.multiple(sizes, **limits):
        # Of those whose sides on the surface depend on what else is in a packet: see `joint_points`.
        on_it = "MANY" not in kinds_of(meshes)
        points = [points_around(rng, mesh, int(rng.integers(0, 9000)), on_it=on_it) for mesh in meshes]
        found = sdm.signed_distances(meshes, points, max_bytes=max_bytes)
        with_hits = sdm.signed_distances(meshes, points, max_bytes=max_bytes, return_closest=True)
        for values, (others, hit), mesh, at in zip(found, with_hits, meshes, points, strict=True):
            alone, own = sdm.signed_distance(mesh, at, return_closest=True)
            assert_same_bits(values, alone, mesh)
            assert_same_bits(others, alone, mesh)
            assert_same_closest(hit, own, mesh.vertices, mesh)


def test_points_near_many_boundary_edges() -> None:
    rng = np.random.default_rng(1)
    meshes = [sdm.TriangleMesh(*torn(torus(40_000), share)).to("cuda") for share in (0.001, 0.02, 0.1, 0.3)]
    assert kinds_of(meshes) == ["OPEN", "MANY", "DIRTY", "DIRTY"]
    points = [points_around(rng, mesh, 20_000, on_it=False) for mesh in meshes]
    for values, mesh, at in zip(sdm.signed_distances(meshes, points), meshes, points, strict=True):
        assert_same_bits(values, sdm.signed_distance(mesh, at), mesh)


def test_points_wait_as_often_however_many_meshes() -> None:
    def waits(count: int) -> int:
        rng = np.random.default_rng(count)
        meshes = [torn_mesh(rng).to("cuda") for _ in range(count)]
        points = [points_around(rng, mesh, 2000, on_it=False) for mesh in meshes]
        torch.cuda.synchronize()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            torch.cuda.set_sync_debug_mode("warn")
            try:
                sdm.signed_distances(meshes, points)
            finally:
                torch.cuda.set_sync_debug_mode("default")
        return sum("called a synchronizing" in str(warning.message) for warning in caught)

    waits(3)
    # A wait for an event, as for the pairing's flags, has no warning.
    assert waits(4) == waits(24) <= 2
