"""Flags and numbers of a mesh's boundary edges that are found on the device."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Places of the flags: a vertex out of range; by how many more edges than guessed are unmatched, and than bound the
# mesh, or if there is room for them, than there is room for; edges that are followed by none.
# Behind them how many are unmatched, and how many bound the mesh.
WRONG_VERTEX, WRONG_UNMATCHED, WRONG_EDGES, TANGLED, FLAGS = 0, 1, 2, 3, 4
ALL_UNMATCHED, ALL_EDGES, NUMBERS = 4, 5, 6


@wp.func
def edges_in(flags: wp.array(dtype=wp.int32), room: int):
    """Boundary edges, as far as they are guessed or have room; none if there is no room for all."""
    edges = flags[ALL_EDGES]
    return wp.where(edges <= room, edges, 0)
