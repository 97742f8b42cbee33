"""Boundary of an open mesh by room: how many edges and caps there are the kernels read from memory.

The caps' tree is one of two meshes that differ, as that of the faces: the caps that there are, and behind them
triangles of one point, which fill the room. So an open mesh that turns out to be closed has a tree without caps.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor

from sdm.engine.capacity.classes import MOST_EDGES
from sdm.kernels.bvh.tree import PART_SIZE, coarser
from sdm.kernels.launch import set_array
from sdm.kernels.topology import boundary_loops
from sdm.kernels.topology.boundary_loops import ALL_EDGES, NUMBERS
from sdm.kernels.winding.boundary_term import gather_boundary
from sdm.kernels.winding.cap_tree import build_caps
from sdm.kernels.winding.winding_number import Winding
from sdm.runtime.torch_warp import as_warp, on_current_stream, repeated_row, workspace

_SIZES = {
    "numbers": (NUMBERS,),
    "ambiguous": (2,),
    "parts": (2 * PART_SIZE,),
    "edges": (MOST_EDGES, 2),
    "caps": (MOST_EDGES + 1, 3),
}
_LENGTH = sum(math.prod(size) for size in _SIZES.values())
# Flags of the join that the host reads, and numbers behind them.
TOLD = NUMBERS - boundary_loops.FLAGS


class OpenBoundary(NamedTuple):
    """Tensors of a boundary, all int32 and zero before, in one piece of memory.

    Args:
        memory: That.
        numbers: (NUMBERS,) as `boundary_loops.join_edges` fills them.
        ambiguous: (2,) of both meshes.
        parts: (2 * PART_SIZE,) of the caps' tree.
        edges: (MOST_EDGES, 2) boundary edges; those that there are come first.
        caps: (MOST_EDGES + 1, 3) caps, in the same way.
    """

    memory: Tensor
    numbers: Tensor
    ambiguous: Tensor
    parts: Tensor
    edges: Tensor
    caps: Tensor

    @classmethod
    def of_memory(cls, memory: Tensor) -> OpenBoundary:
        """The tensors in a piece of memory."""
        pieces = memory.split([torch.Size(size).numel() for size in _SIZES.values()])
        return cls(memory, *(piece.view(size) for piece, size in zip(pieces, _SIZES.values(), strict=True)))

    @staticmethod
    def length() -> int:
        """Numbers in that memory."""
        return _LENGTH

    @classmethod
    def empty(cls, device: torch.device) -> OpenBoundary:
        """New tensors."""
        return cls.of_memory(torch.zeros(_LENGTH, dtype=torch.int32, device=device))

    def queue_joining(self, unmatched: Tensor, found: Tensor, vertices: Tensor) -> None:
        """Queue the kernels that fill numbers, edges and caps from the pairing of the faces of `vertices` (V,3)."""
        with on_current_stream(vertices, vertices):
            boundary_loops.join_edges(
                as_warp(unmatched[:MOST_EDGES], wp.int32),
                as_warp(found, wp.int32),
                as_warp(vertices[None], wp.vec3),
                as_warp(self.edges, wp.int32),
                as_warp(self.caps, wp.int32),
                as_warp(self.numbers, wp.int32),
                workspace(vertices.device),
                in_room=True,
            )

    def queue_caps(self, view: Any, vertices: Tensor, bounds: wp.array, empty: Any) -> Any:
        """Queue kernels that fill boundary and caps of a structure's `view`, whose tree is there: what they fill."""
        winding: Any = Winding()
        for name in ("ends", "lattice"):
            set_array(winding.boundary, name, getattr(view.winding.boundary, name))
        set_array(winding.boundary, "counted", as_warp(self.numbers[ALL_EDGES : ALL_EDGES + 1], wp.int32))
        set_array(winding.boundary, "parts", as_warp(self.parts, wp.int32))
        winding.boundary.count, winding.boundary.in_room = MOST_EDGES, 1
        winding.caps.tree = coarser(view.winding.caps.tree, 0)
        set_array(winding.caps.tree, "parts", as_warp(self.parts, wp.int32))
        winding.caps.tree.meshes = 2
        set_array(winding.caps, "moments", view.winding.caps.moments)
        winding.kind = view.winding.kind
        corners = as_warp(vertices[None], wp.vec3)
        gather_boundary(winding.boundary, view.tree, corners, as_warp(self.edges, wp.int32))
        room = 2 * self.caps.shape[0]
        keys, slots = empty(room, wp.int64), empty(room, wp.int32)
        caps = as_warp(self.caps, wp.int32)
        build_caps(winding.caps, repeated_row(corners, 2), caps, bounds, keys, slots, fillers=True)
        return winding
