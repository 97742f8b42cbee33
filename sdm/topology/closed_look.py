"""One quick look at a mesh on the host that finds most meshes plain: closed, and every component facing outward."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from sdm.kernels.topology.closed_look import SUMS, look_whether_closed, slots_for
from sdm.runtime.torch_warp import as_warp


def is_plainly_closed(vertices: Tensor, faces: Tensor, least: float) -> bool:
    """True if each edge belongs to two faces, once in each direction, and each component encloses more than `least`.

    Args:
        vertices: (V,3) float32 on the host.
        faces: (F,3) int32 on the host.
        least: As for `sdm.topology.component_volumes.every_component_encloses`.

    False is said of all other meshes, closed ones among them: of those whose faces meet at equal positions and not at
    the same vertices, at edges of four faces, or with edges from a vertex to itself. Takes one thread.
    """
    count = faces.shape[0]
    # A closed mesh has at least four faces, and three edges for two faces.
    if count < 4 or count % 2:
        return False
    vertices, faces, slots = vertices.detach().contiguous(), faces.contiguous(), slots_for(count)
    keys = torch.empty(slots, dtype=torch.int64, device="cpu")
    waiting = torch.empty(slots, dtype=torch.int32, device="cpu")
    parent = torch.empty(count, dtype=torch.int32, device="cpu")
    sums = torch.empty(SUMS * count, dtype=torch.float64, device="cpu")
    plain = torch.empty(1, dtype=torch.int32, device="cpu")
    look_whether_closed(
        as_warp(vertices, wp.vec3),
        as_warp(faces, wp.int32),
        least,
        as_warp(keys, wp.int64),
        as_warp(waiting, wp.int32),
        as_warp(parent, wp.int32),
        as_warp(sums, wp.float64),
        as_warp(plain, wp.int32),
    )
    return bool(plain.item())
