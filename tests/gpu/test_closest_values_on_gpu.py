"""Closest points of slabs and lists on a GPU: those of single maps."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case

pytestmark = pytest.mark.gpu


def test_slabs_and_lists_have_the_closest_points_of_single_maps():
    meshes = []
    for name in ("cube", "torus-2000", "open hemisphere"):
        case = load_case(name)
        meshes.append(sdm.TriangleMesh(case.vertices, case.faces).to("cuda"))
    grids = [sdm.Grid.around(mesh, (40, 20, 24)) for mesh in meshes]
    for sign in ("winding", "none", "flood"):
        together = sdm.signed_distance_maps(meshes, grids, return_closest=True, sign=sign)
        for (field, hit), mesh, grid in zip(together, meshes, grids, strict=True):
            index = sdm.MeshIndex(mesh, "cuda", warn=False)
            alone, own = index.signed_distance_map(grid, return_closest=True, sign=sign)
            assert torch.equal(field.values, alone.values)
            assert torch.equal(hit.points, own.points)
            assert torch.equal(hit.faces, own.faces)
            slabs = list(index.slabs(grid, 1, return_closest=True, sign=sign))
            assert torch.equal(torch.cat([hit.points for *_, hit in slabs]), own.points)
            assert torch.equal(torch.cat([values for _, _, values, _ in slabs]), alone.values)
