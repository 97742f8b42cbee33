"""Symmetric tensors of the third and fourth order, of which the third and fourth moments of caps are made.

Harmonic functions do not see the traces of a moment. A tensor of the fourth order without them has nine entries of its
own, xxxx, xxxy, xxxz, xxyy, xxyz, xyyy, xyyz, yyyy and yyyz; the others follow, as each trace is zero.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# The entries xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz and zzz of a symmetric tensor.
CubicInDouble = wp.types.vector(length=10, dtype=wp.float64)
# The entries xxxx, xxxy, xxxz, xxyy, xxyz, xxzz, xyyy, xyyz, xyzz, xzzz, yyyy, yyyz, yyzz, yzzz and zzzz.
QuarticInDouble = wp.types.vector(length=15, dtype=wp.float64)
# Those that do not follow from others, as they lie in memory.
Quartic = wp.types.vector(length=9, dtype=wp.float32)


@wp.func
def symmetric_cubic(m: wp.mat33d, t: wp.vec3d):
    """sym(m t) of a symmetric matrix."""
    part = wp.float64(1.0) / wp.float64(3.0)
    two = wp.float64(2.0)
    found = CubicInDouble()
    found[0] = m[0, 0] * t[0]
    found[1] = part * (m[0, 0] * t[1] + two * m[0, 1] * t[0])
    found[2] = part * (m[0, 0] * t[2] + two * m[0, 2] * t[0])
    found[3] = part * (m[1, 1] * t[0] + two * m[0, 1] * t[1])
    found[4] = part * (m[0, 1] * t[2] + m[0, 2] * t[1] + m[1, 2] * t[0])
    found[5] = part * (m[2, 2] * t[0] + two * m[0, 2] * t[2])
    found[6] = m[1, 1] * t[1]
    found[7] = part * (m[1, 1] * t[2] + two * m[1, 2] * t[1])
    found[8] = part * (m[2, 2] * t[1] + two * m[1, 2] * t[2])
    found[9] = m[2, 2] * t[2]
    return found


@wp.func
def symmetric_quartic(m: CubicInDouble, t: wp.vec3d):
    """sym(m t) of a symmetric tensor of the third order."""
    x = wp.float64(0.25) * t[0]
    y = wp.float64(0.25) * t[1]
    z = wp.float64(0.25) * t[2]
    two = wp.float64(2.0)
    three = wp.float64(3.0)
    found = QuarticInDouble()
    found[0] = m[0] * t[0]
    found[1] = three * m[1] * x + m[0] * y
    found[2] = three * m[2] * x + m[0] * z
    found[3] = two * (m[3] * x + m[1] * y)
    found[4] = two * m[4] * x + m[2] * y + m[1] * z
    found[5] = two * (m[5] * x + m[2] * z)
    found[6] = m[6] * x + three * m[3] * y
    found[7] = m[7] * x + two * m[4] * y + m[3] * z
    found[8] = m[8] * x + m[5] * y + two * m[4] * z
    found[9] = m[9] * x + three * m[5] * z
    found[10] = m[6] * t[1]
    found[11] = three * m[7] * y + m[6] * z
    found[12] = two * (m[8] * y + m[7] * z)
    found[13] = m[9] * y + three * m[8] * z
    found[14] = m[9] * t[2]
    return found


@wp.func
def mean_cubic(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """The mean of y y y over a triangle with corners at a, b and c."""
    total = a + b + c
    thirtieth = wp.float64(1.0) / wp.float64(30.0)
    pairs = wp.float64(1.5) * (wp.outer(a, a) + wp.outer(b, b) + wp.outer(c, c)) + wp.float64(0.5) * wp.outer(
        total, total
    )
    found = symmetric_cubic(wp.outer(a, a), a) + symmetric_cubic(wp.outer(b, b), b) + symmetric_cubic(wp.outer(c, c), c)
    return thirtieth * (found + symmetric_cubic(pairs, total))


@wp.func
def without_traces(m: QuarticInDouble):
    """The nine entries of a symmetric tensor less its traces."""
    xx = m[0] + m[3] + m[5]
    xy = m[1] + m[6] + m[8]
    xz = m[2] + m[7] + m[9]
    yy = m[3] + m[10] + m[12]
    yz = m[4] + m[11] + m[13]
    zz = m[5] + m[12] + m[14]
    trace = (xx + yy + zz) / wp.float64(35.0)
    seventh = wp.float64(1.0) / wp.float64(7.0)
    three = wp.float64(3.0)
    six = wp.float64(6.0)
    found = Quartic()
    found[0] = float(m[0] - six * seventh * xx + three * trace)
    found[1] = float(m[1] - three * seventh * xy)
    found[2] = float(m[2] - three * seventh * xz)
    found[3] = float(m[3] - seventh * (xx + yy) + trace)
    found[4] = float(m[4] - seventh * yz)
    found[5] = float(m[6] - three * seventh * xy)
    found[6] = float(m[7] - seventh * xz)
    found[7] = float(m[10] - six * seventh * yy + three * trace)
    found[8] = float(m[11] - three * seventh * yz)
    return found


@wp.func
def all_entries(m: Quartic):
    """All entries of a tensor without traces, from its nine."""
    found = QuarticInDouble()
    found[0] = wp.float64(m[0])
    found[1] = wp.float64(m[1])
    found[2] = wp.float64(m[2])
    found[3] = wp.float64(m[3])
    found[4] = wp.float64(m[4])
    found[6] = wp.float64(m[5])
    found[7] = wp.float64(m[6])
    found[10] = wp.float64(m[7])
    found[11] = wp.float64(m[8])
    found[5] = -found[0] - found[3]
    found[8] = -found[1] - found[6]
    found[9] = -found[2] - found[7]
    found[12] = -found[3] - found[10]
    found[13] = -found[4] - found[11]
    found[14] = -found[5] - found[12]
    return found


@wp.func
def quartic_at(m: Quartic, z: wp.vec3):
    """M Z Z Z Z of a tensor without traces."""
    xx = z[0] * z[0]
    yy = z[1] * z[1]
    zz = z[2] * z[2]
    even = m[0] * (xx * (xx - 6.0 * zz) + zz * zz) + m[7] * (yy * (yy - 6.0 * zz) + zz * zz)
    even = even + m[3] * (6.0 * (xx * yy - (xx + yy) * zz) + 2.0 * zz * zz)
    odd = 4.0 * z[0] * z[1] * (m[1] * (xx - 3.0 * zz) + m[5] * (yy - 3.0 * zz))
    odd = odd + 4.0 * z[0] * z[2] * (m[2] * (xx - zz) + m[6] * (3.0 * yy - zz))
    return even + odd + 4.0 * z[1] * z[2] * (m[4] * (3.0 * xx - zz) + m[8] * (yy - zz))
