"""Signs of open meshes' maps: whole numbers far from the holes, the winding number near them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.topology.boundary_edges import boundary_edges


def _with_holes() -> sdm.TriangleMesh:
    """A torus without some of its faces: small holes and a large one, everywhere."""
    case = load_case("torus")
    gone = np.zeros(len(case.faces), bool)
    gone[[5, 6, 7, 900, 2000, 2001, 3333]] = True
    gone[3500:3600] = True
    return sdm.TriangleMesh(case.vertices, case.faces[~gone])


def _hemisphere() -> sdm.TriangleMesh:
    case = load_case("open hemisphere")
    return sdm.TriangleMesh(case.vertices, case.faces)


@pytest.mark.parametrize("make", [_with_holes, _hemisphere])
@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_signs_and_counts_are_those_of_the_winding_number(make, turn):
    mesh = make()
    assert 0 < len(boundary_edges(mesh.vertices, mesh.faces)) < 1024
    c, s = np.cos(turn), np.sin(turn)
    direction = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    box = sdm.Grid.around(mesh, resolution=44)
    grid = sdm.Grid(box.origin, box.spacing, box.shape, direction)
    index = sdm.MeshIndex(mesh, "cpu")
    field = index.signed_distance_map(grid)
    winding = index.winding_number(grid.points())
    # Where the winding number is one half to its last bits, either side is right.
    sure = (winding - 0.5).abs() > 1e-5
    assert torch.equal((field.values < 0)[sure], (winding > 0.5)[sure])
    unclear = int(((winding - 0.5).abs() < 0.25).sum())
    assert unclear > 0
    assert abs(field.ambiguous_voxels - unclear) <= 2
