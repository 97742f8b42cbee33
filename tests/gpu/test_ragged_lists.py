"""Lists of meshes that differ on a GPU: bit for bit what single calls give, however they are cut into chunks."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from tests.property.test_ragged_lists import random_grid, random_mesh

pytestmark = [pytest.mark.gpu, pytest.mark.filterwarnings("ignore::sdm.SDMWarning")]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("max_bytes", [None, 1 << 22])
def test_maps_and_distances_are_those_of_single_calls(seed: int, max_bytes: int | None) -> None:
    rng = np.random.default_rng(seed)
    meshes = [random_mesh(rng).to("cuda") for _ in range(12)]
    grids = [random_grid(rng, mesh) for mesh in meshes]
    found = sdm.signed_distance_maps(meshes, grids, max_bytes=max_bytes)
    for i, (field, mesh, grid) in enumerate(zip(found, meshes, grids, strict=True)):
        alone = sdm.signed_distance_map(mesh, grid)
        assert torch.equal(field.values, alone.values), (i, mesh, grid)
        assert field.ambiguous_voxels == alone.ambiguous_voxels
    points = [torch.randn(int(rng.integers(0, 9000)), 3, device="cuda") for _ in meshes]
    for values, mesh, at in zip(sdm.signed_distances(meshes, points, max_bytes=max_bytes), meshes, points, strict=True):
        assert torch.equal(values, sdm.signed_distance(mesh, at))


def test_meshes_of_the_host_are_taken_there() -> None:
    meshes = [random_mesh(np.random.default_rng(seed)) for seed in range(5)]
    for field, mesh in zip(sdm.signed_distance_maps(meshes, 20, device="cuda"), meshes, strict=True):
        assert field.device.type == "cuda"
        assert torch.equal(field.values, sdm.signed_distance_map(mesh, 20, device="cuda").values)


def test_a_face_out_of_range_is_named_by_its_mesh() -> None:
    good = random_mesh(np.random.default_rng(0)).to("cuda")
    bad = sdm.TriangleMesh(good.vertices, good.faces + 1, check=False)
    with pytest.raises(sdm.MeshError, match=r"^mesh 2: a face uses vertex"):
        sdm.signed_distance_maps([good, good, bad, good], 16)
