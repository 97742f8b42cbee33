"""Where a family has put a user's own mesh: the way back from a sample to that mesh's coordinates."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.shapes import Family, MeshFolder
from sdm.shapes.mesh_folder import _warped_vertices

# Columns of theta after these are the warp's coefficients.
RIGID = 8


def transforms_of(family: Family, theta: Tensor) -> Tensor | None:
    """Matrices (B,4,4) float64 from a mesh's own coordinates to those of its sample, for theta (B,P) on the host.

    They are the family's scale, rotation and shift; the smooth warp comes before them. None for families whose shapes
    have no coordinates of their own.
    """
    if not isinstance(family, MeshFolder):
        return None
    plain = theta.clone()
    plain[:, RIGID:] = 0
    _, _, anchors, frames, constants = family._tables
    which = theta[:, 0].floor().long().clamp(0, len(family.meshes) - 1)
    found = torch.empty(theta.shape[0], 4, 4, dtype=torch.float64, device="cpu")
    for number in which.unique().tolist():
        rows = which == number
        centre, half = frames[number, :3], frames[number, 3]
        # An affine map is known by where it takes a point and three steps from it.
        probes = torch.cat([centre[None], centre + half * torch.eye(3, dtype=torch.float32, device="cpu")])
        owner = torch.full((4,), number, dtype=torch.int32, device="cpu")
        moved = _warped_vertices(plain[rows], [probes, owner, anchors, frames, constants], 4).double()
        linear = (moved[:, 1:] - moved[:, :1]).transpose(1, 2) / half.double()
        matrix = torch.eye(4, dtype=torch.float64, device="cpu").repeat(int(rows.sum()), 1, 1)
        matrix[:, :3, :3] = linear
        matrix[:, :3, 3] = moved[:, 0] - linear @ centre.double()
        found[rows] = matrix
    return found
