"""Solid angle of all caps of a mesh from a point in float32, with a bound that grows with their angles alone.

Most caps are small from most points. So single angles are added up, in two float32 numbers, and not the arguments of a
product, where each factor leaves a rounding however small its angle is: of 15,000 caps that would be a hundred times as
much as all else.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import tree_of
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.near_caps import CAP, FULL, SECOND, SEEN, TOOLS, UNIT, WIDER

wp.set_module_options({"enable_backward": False})

# Up to so much of a tangent the first terms of the angle's series are exact to a rounding. The rounding of an angle, in
# proportion to it, and of the last sum.
SMALL, ROUNDED, SUMMED = 0.25, 8.0 * UNIT, 16.0 * UNIT


@wp.func_native(
    snippet=f"""
    {TOOLS}
    const float px = p.c[0], py = p.c[1], pz = p.c[2];
    float sum = 0.0f, rest = 0.0f, error = 0.0f;
    for (int i = lane; i < count; i += lanes) {{
        const int place = 4 * (first_slot + i);
        {CAP}
        {SEEN}
        const float x = f * part, y = v * part, square = y * y;
        float angle = y - y * square * (0.33333333f - square * (0.2f - square * (0.14285714f
            - square * (0.11111111f - square * 0.09090909f))));
        if (x < 0.5f || fabsf(y) > {SMALL}f)
            angle = atan2f(y, x);
        angle = known ? angle : 0.0f;
        const float off = {SECOND}f * inverse * (fabsf(y) * along + across);
        error = known ? error + off + {ROUNDED}f * fabsf(angle) : INFINITY;
        const float next = sum + angle, added = next - sum;
        rest += (sum - (next - added)) + (angle - added);
        sum = next;
    }}
    return wp::vec2({2.0 / FULL}f * (sum + rest), {2.0 * WIDER / FULL}f * (error + {SUMMED}f * (fabsf(sum) + 1e-3f)));
"""
)
def cap_sum(
    corners: wp.array(dtype=wp.vec3), first_slot: int, count: int, p: wp.vec3, lane: int, lanes: int
) -> wp.vec2:
    """A lane's part of the share of so many caps of the winding number at p (scaled), and the largest error of it."""
    ...


@wp.func
def cap_part(caps: Caps, mesh: int, p: wp.vec3, lane: int, lanes: int):
    """A lane's part of the share of a mesh's caps of the winding number at p (scaled), and the largest error of it.

    The error is infinite if nothing is known.
    """
    one = tree_of(caps.tree, mesh)
    return cap_sum(caps.tree.corners, one.first, one.count, p, lane, lanes)
