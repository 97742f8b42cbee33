"""Test on the device of whether a mesh that moved still has the boundary that was found before.

Faces say which edges are unmatched; positions only say which ends of those are at one place. As long as that is so,
boundary edges and caps are those of before, and the host, which found them, need not look at the vertices again.
"""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from sdm.kernels.topology.ends_at_one_place import compare_ends, join_ends
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.topology.boundary_edges import MOST_ON_HOST
from sdm.topology.face_pairing import Pairing

# Comparisons that take a GPU less time than to bring the ends to the host.
MOST_COMPARISONS = 1 << 26


def can_be_told(pairing: Pairing, meshes: int) -> bool:
    """True if so many meshes are open, and by few enough edges for a device to compare each end with each."""
    edges = pairing.unmatched.shape[0]
    return 0 < edges <= MOST_ON_HOST and meshes * (2 * edges) ** 2 <= MOST_COMPARISONS


def note_ends(pairing: Pairing, vertices: Tensor) -> None:
    """Note which ends of the unmatched edges are at one place, for which `pairing.edges` were just found.

    `vertices` is (B,V,3), contiguous.
    """
    same = torch.empty(2 * pairing.unmatched.shape[0], dtype=torch.int32, device=vertices.device)
    with on_current_stream(vertices, vertices):
        join_ends(as_warp(pairing.unmatched, wp.int32), as_warp(vertices, wp.vec3), as_warp(same, wp.int32))
    pairing.same = same


def queue_comparison(unmatched: Tensor, same: Tensor, vertices: Tensor) -> Tensor:
    """Flags (1,) int32: zero if ends that were at one place are so with these vertices (B,V,3), and no others."""
    flags = torch.zeros(1, dtype=torch.int32, device=vertices.device)
    with on_current_stream(vertices, vertices):
        compare_ends(
            as_warp(unmatched, wp.int32), as_warp(vertices, wp.vec3), as_warp(same, wp.int32), as_warp(flags, wp.int32)
        )
    return flags
