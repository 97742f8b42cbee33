"""Beads beside a closed surface: voxels at the rim of a sheet that are inside, though none next to them is.

A plate of half a voxel to each side of a sheet is joined wherever the sheet goes on. Where it ends, a voxel may be
within the offset of its last corner while all its neighbours are not, and becomes a surface of its own.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.engine.mesh_index import MeshIndex
from sdm.inspect.edges import label
from sdm.inspect.positions import first_at_position

# Vertices of a surface around three voxels in a row, and how many edges are between any two of them.
MOST_VERTICES, ROUNDS = 14, 8
# With offsets of half a voxel's diagonal there are none, in voxels.
JOINED = 0.87


def without_beads(surface: TriangleMesh, index: MeshIndex) -> TriangleMesh:
    """The surface without its beads, as far as the part of the mesh that each is nearest to has a larger one too."""
    least, beads = beads_of(surface)
    if not bool(beads.any()):
        return surface
    vertices, faces = index.mesh.numpy()
    merged = first_at_position(vertices)[faces.astype(np.int64)]
    part_of = label(np.concatenate([merged[:, 0], merged[:, 1]]), merged[:, 1:].T.reshape(-1), len(vertices))
    part = torch.from_numpy(part_of[merged[:, 0]]).to(surface.device)
    _, hit = index.signed_distance(surface.vertices, sign="none", return_closest=True)
    nearest = part[hit.faces.long()]
    others = torch.isin(nearest, nearest[~beads].unique()).int()
    # All of a bead, or nothing of it.
    kept = ~beads | (torch.ones_like(others).scatter_reduce(0, least, others, "amin")[least] == 0)
    place = kept.cumsum(0, dtype=torch.int32) - 1
    left = surface.faces[kept[surface.faces[:, 0].long()]].long()
    return TriangleMesh(surface.vertices[kept], place[left], surface.name, check=False)


def beads_of(surface: TriangleMesh) -> tuple[Int64[Tensor, " v"], Bool[Tensor, " v"]]:
    """A number for each vertex (V,), the same for all of a small part; and marks of those parts' vertices.

    Parts are small if they have at most `MOST_VERTICES`.
    """
    corners = surface.faces.long()
    own = torch.arange(len(surface.vertices), device=surface.device)
    least = own
    for _ in range(ROUNDS):
        of_face = least[corners].amin(1, keepdim=True).expand(-1, 3)
        least = least.scatter_reduce(0, corners.reshape(-1), of_face.reshape(-1), "amin")
    count = torch.zeros_like(own).scatter_add(0, least, torch.ones_like(own))
    # The least number of a small part has come everywhere, so that none of its faces has two.
    numbers = least[corners]
    several = numbers[(numbers != numbers[:, :1]).any(1)]
    mixed = torch.zeros_like(own, dtype=torch.bool)
    mixed[several.reshape(-1)] = True
    return least, ((count <= MOST_VERTICES) & ~mixed)[least]
