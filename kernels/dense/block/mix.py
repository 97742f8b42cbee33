"""Which of the parts that wait are worked out together: one a lane, corners first, then edges, then faces.

Parts of one kind that fill all lanes go by themselves; only what is left in the end is mixed, as lanes that do
different things wait for each other.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.block.feature_rows import CORNER_KIND, EDGE_KIND, FACE_KIND

wp.set_module_options({"enable_backward": False})


@wp.struct
class Mix:
    """So many corners, edges, and parts in all."""

    corners: wp.int32
    edges: wp.int32
    parts: wp.int32


@wp.func
def taken_now(corners: int, edges: int, faces: int, lanes: int):
    """Of the parts that wait those to take now."""
    mix = Mix()
    mixed = corners < lanes and edges < lanes and faces < lanes
    if mixed or corners >= lanes:
        mix.corners = wp.min(corners, lanes)
        mix.parts = mix.corners
    if mixed or (edges >= lanes and mix.parts == 0):
        mix.edges = wp.min(edges, lanes - mix.parts)
        mix.parts = mix.parts + mix.edges
    if mixed or mix.parts == 0:
        mix.parts = mix.parts + wp.min(faces, lanes - mix.parts)
    return mix


@wp.func
def kind_of(mix: Mix, part: int):
    """The kind of a part."""
    if part < mix.corners:
        return CORNER_KIND
    return wp.where(part < mix.corners + mix.edges, EDGE_KIND, FACE_KIND)
