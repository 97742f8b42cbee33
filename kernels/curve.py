"""The Hilbert curve that triangles and points are sorted along: neighbours on it are neighbours in space."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

CURVE_BITS = wp.constant(10)


@wp.func
def hilbert_code(x: wp.uint32, y: wp.uint32, z: wp.uint32):
    """Position along a 3D Hilbert curve of 10 bits an axis (Skilling 2004). It never jumps, unlike Morton order."""
    v = wp.vec3ui(x, y, z)
    one = wp.uint32(1)
    q = one << wp.uint32(CURVE_BITS - 1)
    while q > one:
        mask = q - one
        for axis in range(3):
            if (v[axis] & q) != wp.uint32(0):
                v[0] = v[0] ^ mask
            else:
                t = (v[0] ^ v[axis]) & mask
                v[0] = v[0] ^ t
                v[axis] = v[axis] ^ t
        q = q >> one
    v[1] = v[1] ^ v[0]
    v[2] = v[2] ^ v[1]
    t = wp.uint32(0)
    q = one << wp.uint32(CURVE_BITS - 1)
    while q > one:
        if (v[2] & q) != wp.uint32(0):
            t = t ^ (q - one)
        q = q >> one
    code = wp.uint32(0)
    for bit in range(CURVE_BITS):
        shift = wp.uint32(CURVE_BITS - 1 - bit)
        for axis in range(3):
            code = (code << one) | (((v[axis] ^ t) >> shift) & one)
    return code


@wp.func
def cell_along(x: float, low: float, high: float):
    """The curve's cell of x between low and high, also for points outside."""
    share = float(0.0)
    if high > low:
        share = (x - low) / (high - low)
    return wp.uint32(wp.clamp(share * 1024.0, 0.0, 1023.0))


@wp.func
def curve_code(p: wp.vec3, low: wp.vec3, high: wp.vec3):
    """Position of p along the curve through the cube on the box's longest edge."""
    size = wp.max(wp.max(high[0] - low[0], high[1] - low[1]), high[2] - low[2])
    top = low + wp.vec3(size, size, size)
    return hilbert_code(
        cell_along(p[0], low[0], top[0]), cell_along(p[1], low[1], top[1]), cell_along(p[2], low[2], top[2])
    )
