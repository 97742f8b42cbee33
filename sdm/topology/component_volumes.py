"""Edge-connected components of faces, and what they enclose."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from sdm.kernels.topology.component_volumes import SUMS, judge_components
from sdm.runtime.torch_warp import as_warp, on_current_stream


def every_component_encloses(least: float, vertices: Tensor, faces: Tensor, neighbours: Tensor) -> bool:
    """True if the signed volume of each component exceeds `least` times its area to the power of 3/2.

    Args:
        least: A share, of either sign. A ball's is 0.094.
        vertices: (V,3) float32.
        faces: (F,3) int32.
        neighbours: (F,4) int32 of `sdm.topology.face_pairing.neighbours`: faces that meet there are of one component.

    The volume of an open component is that of the cone from the middle of its corners. Waits for the device once.
    """
    count, device = faces.shape[0], faces.device
    vertices, faces = vertices.detach().contiguous(), faces.contiguous()
    parent = torch.empty(count, dtype=torch.int32, device=device)
    sums = torch.empty(SUMS * count, dtype=torch.float64, device=device)
    flag = torch.zeros(1, dtype=torch.int32, device=device)
    with on_current_stream(faces, vertices, faces, neighbours):
        judge_components(
            as_warp(vertices, wp.vec3),
            as_warp(faces, wp.int32),
            as_warp(neighbours, wp.int32),
            least,
            as_warp(parent, wp.int32),
            as_warp(sums, wp.float64),
            as_warp(flag, wp.int32),
        )
    return not flag.item()
