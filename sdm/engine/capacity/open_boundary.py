"""Boundary of an open mesh by room: how many edges and caps there are the kernels read from memory.

The caps' tree is one of two meshes that differ, as that of the faces: the caps that there are, and behind them
triangles of one point, which fill the room. So an open mesh that turns out to be closed has a tree without caps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import warp as wp
from torch import Tensor

from sdm.engine.capacity.classes import BY_FACES
from sdm.kernels.bvh.tree import PART_SIZE, coarser
from sdm.kernels.launch import set_array
from sdm.kernels.topology import boundary_loops
from sdm.kernels.topology.boundary_flags import ALL_EDGES, FLAGS, NUMBERS
from sdm.kernels.topology.filler_faces import FACES
from sdm.kernels.winding.boundary_term import gather_boundary, write_parts_of_faces
from sdm.kernels.winding.cap_tree import build_caps
from sdm.kernels.winding.winding_number import Winding
from sdm.runtime.graphs.branches import MOMENTS, Join, kernels_beside, nothing
from sdm.runtime.torch_warp import as_warp, on_current_stream, repeated_row, workspace
from sdm.topology.cap_triangles import turned

# Numbers behind the flags of the join that the host reads.
TOLD = NUMBERS - FLAGS


@lru_cache(maxsize=16)
def _sizes(room: int) -> dict[str, tuple[int, ...]]:
    return {
        "numbers": (NUMBERS,),
        "ambiguous": (2,),
        "parts": (2 * PART_SIZE,),
        "edges": (room, 2),
        "caps": (room + 1, 3),
    }


class OpenBoundary(NamedTuple):
    """Tensors of a boundary, all int32 and zero before, in one piece of memory.

    Args:
        memory: That.
        numbers: (NUMBERS,) as `boundary_loops.join_edges` fills them.
        ambiguous: (2,) of both meshes.
        parts: (2 * PART_SIZE,) of the caps' tree.
        edges: (room, 2) boundary edges; those that there are come first.
        caps: (room + 1, 3) caps, in the same way.
    """

    memory: Tensor
    numbers: Tensor
    ambiguous: Tensor
    parts: Tensor
    edges: Tensor
    caps: Tensor

    @classmethod
    def of_memory(cls, memory: Tensor, room: int) -> OpenBoundary:
        """The tensors in a piece of memory, with room for so many boundary edges."""
        sizes = _sizes(room).values()
        pieces = memory.split([math.prod(size) for size in sizes])
        return cls(memory, *(piece.view(size) for piece, size in zip(pieces, sizes, strict=True)))

    @staticmethod
    def joined(memory: Tensor, room: int, count: int) -> tuple[Tensor, Tensor]:
        """Boundary edges (count,2) and caps (count,3) in such a piece of memory."""
        before = 0
        found = {}
        for name, size in _sizes(room).items():
            if name in ("edges", "caps"):
                found[name] = memory[before : before + count * size[1]].view(count, size[1])
            before += math.prod(size)
        return found["edges"], found["caps"]

    @staticmethod
    @lru_cache(maxsize=16)
    def length(room: int) -> int:
        """Numbers in that memory."""
        return sum(math.prod(size) for size in _sizes(room).values())

    @property
    def room(self) -> int:
        """The edges, unmatched or of the boundary, that there is room for."""
        return self.edges.shape[0]

    @property
    def by_faces(self) -> bool:
        """True if the faces turned inside out are the caps, so that nobody needs others."""
        return self.room in BY_FACES

    def queue_joining(
        self, unmatched: Tensor, found: Tensor, vertices: Tensor, written: Callable[[], None] | None = None
    ) -> None:
        """Queue the kernels that fill numbers, edges and caps from the pairing of the faces of `vertices` (V,3).

        `written` is called once those are queued that write the edges.
        """
        with on_current_stream(vertices, vertices):
            boundary_loops.join_edges(
                as_warp(unmatched[: self.room], wp.int32),
                as_warp(found, wp.int32),
                as_warp(vertices[None], wp.vec3),
                as_warp(self.edges, wp.int32),
                None if self.by_faces else as_warp(self.caps, wp.int32),
                as_warp(self.numbers, wp.int32),
                workspace(vertices.device),
                in_room=True,
                written=written,
            )

    @property
    def _parts_of_caps(self) -> Tensor:
        # Of faces there are others, where no caps are written.
        return self.caps.view(-1)[: 2 * PART_SIZE] if self.by_faces else self.parts

    def winding(self, view: Any) -> Any:
        """Winding data in a structure's `view`, which `queue_winding` fills."""
        winding: Any = Winding()
        for name in ("ends", "lattice"):
            set_array(winding.boundary, name, getattr(view.winding.boundary, name))
        set_array(winding.boundary, "counted", as_warp(self.numbers[ALL_EDGES : ALL_EDGES + 1], wp.int32))
        set_array(winding.boundary, "parts", as_warp(self.parts, wp.int32))
        winding.boundary.count, winding.boundary.in_room = self.room, 1
        winding.caps.tree = coarser(view.winding.caps.tree, 0)
        set_array(winding.caps.tree, "parts", as_warp(self._parts_of_caps, wp.int32))
        winding.caps.are_faces = int(self.by_faces)
        winding.caps.tree.meshes = 2
        set_array(winding.caps, "moments", view.winding.caps.moments)
        winding.kind = view.winding.kind
        return winding

    def queue_winding(
        self,
        winding: Any,
        tree: Any,
        vertices: Tensor,
        faces: Tensor,
        counts: Tensor,
        bounds: wp.array,
        empty: Any,
        edges_alone: bool,
        joined: Join,
    ) -> Join:
        """Queue kernels that fill `winding`, whose `tree` and edges are there: of `edges_alone` without caps.

        These are there after `joined`. What it gives is to be called before the caps' moments are read. `faces` (F,3),
        of which there are as many as `counts` (COUNTS,) say.
        """
        corners = as_warp(vertices[None], wp.vec3)
        gather_boundary(winding.boundary, tree, corners, as_warp(self.edges, wp.int32))
        if edges_alone:
            return nothing
        triangles = self.caps
        if self.by_faces:
            triangles = turned(faces)
            parts = as_warp(self._parts_of_caps, wp.int32)
            write_parts_of_faces(as_warp(counts, wp.int32), FACES, faces.shape[0], parts)
        else:
            joined()
        room = 2 * triangles.shape[0]
        keys, slots = empty(room, wp.int64), empty(room, wp.int32)
        caps = as_warp(triangles, wp.int32)
        # Until the kernels are queued that read them.
        empty.kept = triangles
        beside = partial(kernels_beside, vertices, MOMENTS)
        return build_caps(
            winding.caps, repeated_row(corners, 2), caps, bounds, keys, slots, fillers=True, beside=beside
        )
