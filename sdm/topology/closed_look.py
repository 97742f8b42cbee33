"""One quick look at a mesh on the host that finds most meshes plain: closed, and every component facing outward."""

from __future__ import annotations

import threading

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.kernels.topology.closed_look import SUMS, look_whether_closed, slots_for
from sdm.runtime.torch_warp import as_warp

# Places of a thread's own: of meshes of some hundred thousand faces.
MOST_KEPT = 1 << 18
_own = threading.local()


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
    vertices, faces = vertices.detach().contiguous(), faces.contiguous()
    plain, _, workspace = _workspace(slots_for(count))
    look_whether_closed(as_warp(vertices, wp.vec3), as_warp(faces, wp.int32), least, *workspace)
    return bool(plain[0])


def _workspace(slots: int) -> tuple[np.ndarray, list[Tensor], list[wp.array]]:
    """The place of the answer, memory for so many places of the table, and both as Warp's arrays.

    A thread keeps it for its next mesh: fresh memory takes the system as long as the look itself, and to make arrays
    takes Python's lock longer than all else here.
    """
    known = getattr(_own, "workspace", None)
    if known is not None and known[0] == slots:
        return known[1]
    # The most faces that have so many places.
    faces = 4 * slots // 9 + 1
    kinds = {wp.int64: torch.int64, wp.int32: torch.int32, wp.float64: torch.float64}
    wanted = (slots, wp.int64), (slots, wp.int32), (faces, wp.int32), (SUMS * faces, wp.float64), (1, wp.int32)
    memory = [torch.empty(size, dtype=kinds[kind], device="cpu") for size, kind in wanted]
    arrays = [as_warp(tensor, kind) for tensor, (_, kind) in zip(memory, wanted, strict=True)]
    made = memory[-1].numpy(), memory, arrays
    if slots <= MOST_KEPT:
        _own.workspace = slots, made
    return made
