"""The Hilbert curve that triangles and points are sorted along: neighbours on it are neighbours in space."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Bits of a place along an axis: of FEW triangles, of more (each eight bits in all take the sort another pass), and of
# points, of which there may be many more to a triangle.
COARSE_BITS, FINE_BITS = 8, 10
FEW = 1 << 17
POINT_BITS = 13


@wp.func
def curve_bits(triangles: int):
    """Bits of a place along an axis, for a mesh of so many triangles."""
    return wp.where(triangles <= FEW, COARSE_BITS, FINE_BITS)


@wp.func
def hilbert_code(x: wp.uint32, y: wp.uint32, z: wp.uint32, bits: int):
    """Position along a 3D Hilbert curve of `bits` bits an axis (Skilling 2004). It never jumps, unlike Morton order."""
    v = wp.vec3ui(x, y, z)
    one = wp.uint32(1)
    q = one << wp.uint32(bits - 1)
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
    q = one << wp.uint32(bits - 1)
    while q > one:
        if (v[2] & q) != wp.uint32(0):
            t = t ^ (q - one)
        q = q >> one
    code = wp.int64(0)
    for bit in range(bits):
        shift = wp.uint32(bits - 1 - bit)
        for axis in range(3):
            code = (code << wp.int64(1)) | wp.int64(((v[axis] ^ t) >> shift) & one)
    return code


@wp.func
def cell_along(x: float, low: float, high: float, bits: int):
    """The curve's cell of x between low and high, also for points outside."""
    share = float(0.0)
    if high > low:
        share = (x - low) / (high - low)
    cells = float(1 << bits)
    return wp.uint32(wp.clamp(share * cells, 0.0, cells - 1.0))


@wp.func
def curve_code(p: wp.vec3, low: wp.vec3, high: wp.vec3, bits: int):
    """Position (int64) of p along the curve of `bits` bits an axis through the cube on the box's longest edge."""
    size = wp.max(wp.max(high[0] - low[0], high[1] - low[1]), high[2] - low[2])
    top = low + wp.vec3(size, size, size)
    return hilbert_code(
        cell_along(p[0], low[0], top[0], bits),
        cell_along(p[1], low[1], top[1], bits),
        cell_along(p[2], low[2], top[2], bits),
        bits,
    )
