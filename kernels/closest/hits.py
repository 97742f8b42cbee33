"""Closest points of a query, as kernels fill them."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Hits:
    """Closest points, if `wanted`."""

    points: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.int32)  # -1 for a point that is not finite; on the way, the slots of nearest triangles
    barycentric: wp.array(dtype=wp.vec3)
    wanted: wp.int32
