"""The transform to voxel faces is the signed distance map of the mesh made of those faces."""

from __future__ import annotations

import torch

import sdm
from sdm.core.mesh import TriangleMesh
from sdm.engine.distance_transform import euclidean_distance_transform


def test_a_box_of_voxels_is_a_box():
    spacing = (1.0, 0.5, 2.0)
    mask = torch.zeros(12, 14, 9, dtype=torch.bool)
    mask[3:8, 2:11, 4:7] = True
    corners = torch.cartesian_prod(torch.tensor([2.5, 7.5]), torch.tensor([1.5, 10.5]), torch.tensor([3.5, 6.5]))
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(q[0], q[i], q[i + 1]) for q in quads for i in (1, 2)]
    mesh = TriangleMesh((corners * torch.tensor(spacing)).numpy(), torch.tensor(faces, dtype=torch.int32).numpy())
    exact = sdm.signed_distance_map(mesh, sdm.Grid((0, 0, 0), spacing, mask.shape), device="cpu").values
    values = euclidean_distance_transform(mask, spacing, signed=True, surface="faces")
    torch.testing.assert_close(values, exact, rtol=1e-6, atol=1e-6)
