"""Distances that are measured with winners on a GPU are those of the map, before they are compared with it."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.grids import turned_around
from sdm.bench.common.meshes import generated_names, load_case
from sdm.engine import map_closest
from sdm.engine.plan_override import plan_override

pytestmark = pytest.mark.gpu


@pytest.mark.parametrize("name", generated_names())
def test_values_are_those_of_the_map(name, monkeypatch):
    monkeypatch.setitem(map_closest.COMPARED, "cuda", False)
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    index = sdm.MeshIndex(mesh, "cuda", warn=False)
    for grid in (sdm.Grid.around(mesh, 40), sdm.Grid.around(mesh, (24, 50, 18)), turned_around(case, 28)):
        with plan_override(method="cells"):
            alone = index.signed_distance_map(grid)
            found = map_closest.closest_map(index.mesh, index._structure, grid)
        other = found.values != alone.values
        assert not other.any(), (int(other.sum()), grid, found.values[other][:3], alone.values[other][:3])


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
