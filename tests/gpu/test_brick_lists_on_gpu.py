"""Lists of bricks on a GPU, where groups of lanes share the work: the bits of one list that a cell's bricks share."""

from __future__ import annotations

from typing import Any

import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.engine.plan_override import plan_override
from tests.helpers.same_bits import assert_same_bits

pytestmark = pytest.mark.gpu

ONE_LIST = {"by_brick": False}
# Whole lists, and splits of which all or some are measured together.
BY_BRICK = ({}, {"list_split": 32}, {"list_split": 32, "split_length": 128}, {"list_split": 64, "split_length": 64})


def map_of(mesh: sdm.TriangleMesh, grid: sdm.Grid, **options: Any) -> torch.Tensor:
    with plan_override(method="cells", cell=16, **options):
        return sdm.signed_distance_map(mesh, grid, device="cuda").values


@pytest.mark.parametrize("resolution", [96, 219])
@pytest.mark.parametrize("name", ["torus-20000", "torus-300000", "overlapping shells", "random soup"])
def test_lists_by_brick_have_the_bits_of_one_list(name, resolution):
    case = load_case(name)
    mesh = sdm.TriangleMesh(torch.from_numpy(case.vertices).cuda(), torch.from_numpy(case.faces).cuda())
    grid = sdm.Grid.around(mesh, resolution=resolution)
    plain = map_of(mesh, grid, **ONE_LIST)
    for options in BY_BRICK:
        # Made by hand at first, and replayed in the end.
        for _ in range(5):
            assert_same_bits(map_of(mesh, grid, by_brick=True, **options), plain, options)


def test_a_batch_by_brick_has_the_bits_of_each_mesh_alone():
    case = load_case("torus-20000")
    vertices, faces = torch.from_numpy(case.vertices).cuda(), torch.from_numpy(case.faces).cuda()
    grid = sdm.Grid.around(sdm.TriangleMesh(vertices, faces), resolution=100)
    batch = torch.stack([vertices, vertices[:, [1, 2, 0]], 0.9 * vertices])
    with plan_override(method="cells", cell=16, by_brick=True, list_split=32):
        maps = sdm.signed_distance_maps(batch, faces, grid)
    for each, values in zip(batch, maps, strict=True):
        assert_same_bits(map_of(sdm.TriangleMesh(each, faces), grid, **ONE_LIST), values, "batch")
