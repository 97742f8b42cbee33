"""The solid angle of an open mesh's caps over a box of voxels, as a polynomial with a bound of its error.

The solid angle of far caps is a harmonic function in the box. With the sources at y about a node's centre, the voxels
at x about the box's, and u between the centres, it is the integral of n.z/|z|^3 for z = u + y - x, which is expanded
in x and y together up to the third order:

    value + slope.x + x.bend x + cubic(x),   value from M1 to M4, slope from M1 to M3, bend from M1, M2, cubic from M1.

The moments (`cap_tree`) and the derivatives of 1/|z| have no traces, so that with Z = u/D, D = |u|, and

    d = M1.Z,   v = M2 Z,   q = v.Z,   w = M3 Z Z,   c = w.Z,   e = M4 Z Z Z Z

a node adds, each divided by D^(order + 2),

    order 0   d
          1   -3 q + (3 d Z - M1).x
          2   7.5 c + (6 v - 15 q Z).x + 7.5 d (Z.x)^2 - 3 (M1.x)(Z.x) - 1.5 d |x|^2
          3   -17.5 e + (52.5 c Z - 22.5 w).x - 52.5 q (Z.x)^2 + 30 (v.x)(Z.x) + 7.5 q |x|^2 - 3 x.M2 x
              + (17.5 d Z - 7.5 M1).x (Z.x)^2 + (1.5 M1 - 7.5 d Z).x |x|^2

Why the rest is bounded: a derivative of order m of 1/|z| along any m unit vectors is at most m!/|z|^(m+1), as a
symmetric form is largest where all its arguments are equal, and there it is m! times a Legendre polynomial. The term
of order i in x and j in y, with its derivative along n, is thus at most (i+j+1)!/(i! j!) R^i |y|^j / D^(i+j+2), R being
the radius of the box; with rho = (R + |y|)/D all terms of the orders i+j = m add up to (m + 1) rho^m / D^2, and those
from the fourth order on to

    rho^4 (5 - 4 rho) / (1 - rho)^2 / D^2.

The quotient is at most that of r, the radius of the node, in the place of |y|. What is left to know is the mean over
the area of (R + |y|)^4, for which sigma^2, the mean of |y|^2, is enough: it is at most R^4 + 4 R^3 sigma +
6 R^2 sigma^2 + 4 R r sigma^2 + r^2 sigma^2. So the rest is at most

    area / D^2 mean of (R + |y|)^4 / D^4 (5 - 4 rho) / (1 - rho)^2.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.winding.cap_tree import Cubic, Moments
from sdm.kernels.winding.fourth_moment import Quartic, quartic_at
from sdm.kernels.winding.near_caps import FULL, UNIT

wp.set_module_options({"enable_backward": False})


ONE_OVER_FULL = 1.0 / FULL
# The factors of xxx, xxy, xxz, xyy, xyz, yyy and yyz; those of xzz, yzz and zzz follow, as the polynomial is harmonic.
Cubes = wp.types.vector(length=7, dtype=wp.float32)


@wp.func
def cubic_of(c: Cubes):
    """All ten factors of a harmonic cubic: of xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz and zzz."""
    f = Cubic()
    f[0] = c[0]
    f[1] = c[1]
    f[2] = c[2]
    f[3] = c[3]
    f[4] = c[4]
    f[5] = -3.0 * c[0] - c[3]
    f[6] = c[5]
    f[7] = c[6]
    f[8] = -3.0 * c[5] - c[1]
    f[9] = -(c[2] + c[6]) / 3.0
    return f


@wp.struct
class Field:
    """The caps' solid angle near a point: at x from it, value + slope.x + x.bend x + cubic, give or take the error."""

    value: wp.float64
    slope: wp.vec3
    squares: wp.vec3  # of bend the entries xx, yy and zz
    products: wp.vec3  # and the sums of its entries xy and yx, xz and zx, yz and zy
    cubes: Cubes  # the first factors of the cubic, see `cubic_of`
    error: float  # infinite if nothing is known
    left_out: float  # what near caps that are not in it may add at most
    near: wp.int32  # how many of them are listed; without a list they are part of the error
    drift: float  # what the rounding of slope and bend is in proportion to


@wp.func
def add_node(field: Field, m: Moments, m4: Quartic, u: wp.vec3, inverse: float, radius: float):
    """Add a far node: `u` leads from the field's centre to the node's, a unit vector times 1 / inverse.

    If the box's radius is zero, its value will do.
    """
    z = u * inverse
    d = wp.dot(m.m1, z)
    v = m.m2 * z
    q = wp.dot(z, v) * inverse
    s = m.m3
    xy = 2.0 * z[0] * z[1]
    xz = 2.0 * z[0] * z[2]
    yz = 2.0 * z[1] * z[2]
    zz = wp.cw_mul(z, z)
    w = wp.vec3(
        zz[0] * s[0] + xy * s[1] + xz * s[2] + zz[1] * s[3] + yz * s[4] + zz[2] * s[5],
        zz[0] * s[1] + xy * s[3] + xz * s[4] + zz[1] * s[6] + yz * s[7] + zz[2] * s[8],
        zz[0] * s[2] + xy * s[4] + xz * s[5] + zz[1] * s[7] + yz * s[8] + zz[2] * s[9],
    )
    i2 = inverse * inverse
    i3 = i2 * inverse
    i4 = i2 * i2
    w = i2 * w
    c = wp.dot(w, z)
    field.value = field.value + wp.float64(i2 * (d - 3.0 * q + 7.5 * c - 17.5 * (i3 * quartic_at(m4, z))))
    if radius > 0.0:
        field.slope = field.slope + i3 * (z * (3.0 * d - 15.0 * q + 52.5 * c) - m.m1 + 6.0 * inverse * v - 22.5 * w)
        # 7.5 (d - 7 q) z z' - (3 m1 - 30 v) z' - 1.5 (d - 5 q) - 3 M2.
        t = (7.5 * d - 52.5 * q) * z - 3.0 * m.m1 + (30.0 * inverse) * v
        plain = 1.5 * d - 7.5 * q
        part = 3.0 * inverse
        diagonal = wp.vec3(
            t[0] * z[0] - plain - part * m.m2[0, 0],
            t[1] * z[1] - plain - part * m.m2[1, 1],
            t[2] * z[2] - plain - part * m.m2[2, 2],
        )
        other = wp.vec3(
            t[0] * z[1] + t[1] * z[0] - 2.0 * part * m.m2[0, 1],
            t[0] * z[2] + t[2] * z[0] - 2.0 * part * m.m2[0, 2],
            t[1] * z[2] + t[2] * z[1] - 2.0 * part * m.m2[1, 2],
        )
        field.squares = field.squares + i4 * diagonal
        field.products = field.products + i4 * other
        a = (17.5 * d) * z - 7.5 * m.m1
        b = 1.5 * m.m1 - (7.5 * d) * z
        i5 = i4 * inverse
        field.cubes = field.cubes + i5 * cubes_of(a, b, zz, xy, xz, yz)
    return field


@wp.func
def cubes_of(a: wp.vec3, b: wp.vec3, squares: wp.vec3, xy: float, xz: float, yz: float):
    """The first factors of a.x (x.H x) + b.x |x|^2, where H has these squares, and the sums of its other entries."""
    c = Cubes()
    c[0] = a[0] * squares[0] + b[0]
    c[1] = a[1] * squares[0] + a[0] * xy + b[1]
    c[2] = a[2] * squares[0] + a[0] * xz + b[2]
    c[3] = a[0] * squares[1] + a[1] * xy + b[0]
    c[4] = a[0] * yz + a[1] * xz + a[2] * xy
    c[5] = a[1] * squares[1] + b[1]
    c[6] = a[2] * squares[1] + a[1] * yz + b[2]
    return c


@wp.func
def bent_at(field: Field, t: wp.vec3):
    """The gradient at t of x.bend x."""
    return wp.vec3(
        2.0 * field.squares[0] * t[0] + field.products[0] * t[1] + field.products[1] * t[2],
        2.0 * field.squares[1] * t[1] + field.products[0] * t[0] + field.products[2] * t[2],
        2.0 * field.squares[2] * t[2] + field.products[1] * t[0] + field.products[2] * t[1],
    )


@wp.func
def moved_field(field: Field, t: wp.vec3):
    """The same field about a point at t from its centre, which is in its ball; without what is near.

    The terms of value, slope, bend and cubic within the ball are up to 8 times the drift, each rounded up to 12 times.
    """
    c = cubic_of(field.cubes)
    x = t[0]
    y = t[1]
    z = t[2]
    squares = wp.vec3(
        3.0 * c[0] * x + c[1] * y + c[2] * z, c[3] * x + 3.0 * c[6] * y + c[7] * z, c[5] * x + c[8] * y + 3.0 * c[9] * z
    )
    products = wp.vec3(
        2.0 * (c[1] * x + c[3] * y) + c[4] * z,
        2.0 * (c[2] * x + c[5] * z) + c[4] * y,
        2.0 * (c[7] * y + c[8] * z) + c[4] * x,
    )
    # The gradient of the cubic.
    steep = wp.vec3(
        squares[0] * x + 0.5 * (products[0] * y + products[1] * z),
        squares[1] * y + 0.5 * (products[0] * x + products[2] * z),
        squares[2] * z + 0.5 * (products[1] * x + products[2] * y),
    )
    bent = bent_at(field, t)
    moved = Field()
    moved.value = field.value + wp.float64(wp.dot(field.slope + 0.5 * bent + steep / 3.0, t))
    moved.slope = field.slope + bent + steep
    moved.squares = field.squares + squares
    moved.products = field.products + products
    moved.cubes = field.cubes
    moved.error = field.error + 96.0 * UNIT * field.drift
    moved.drift = field.drift
    return moved


@wp.func
def share_at(field: Field, x: wp.vec3):
    """The caps' share of the winding number at x from the field's centre."""
    curved = wp.dot(field.squares, wp.cw_mul(x, x)) + field.products[0] * x[0] * x[1]
    curved = curved + field.products[1] * x[0] * x[2] + field.products[2] * x[1] * x[2]
    c = cubic_of(field.cubes)
    cubic = x[0] * (x[0] * (c[0] * x[0] + c[1] * x[1] + c[2] * x[2]) + x[1] * (c[3] * x[1] + c[4] * x[2]))
    cubic = cubic + x[1] * x[1] * (c[6] * x[1] + c[7] * x[2])
    cubic = cubic + x[2] * x[2] * (c[5] * x[0] + c[8] * x[1] + c[9] * x[2])
    return (float(field.value) + wp.dot(field.slope, x) + curved + cubic) * ONE_OVER_FULL


@wp.func
def doubt(field: Field):
    """The largest error of that."""
    return field.error * ONE_OVER_FULL


@wp.func
def most_change(field: Field, half: wp.vec3):
    """A bound of how far the caps' share is from that at the centre, all over a box of these half-widths."""
    slope = wp.dot(wp.abs(field.slope), half)
    curved = wp.dot(wp.abs(field.squares), wp.cw_mul(half, half)) + wp.abs(field.products[0]) * half[0] * half[1]
    curved = curved + wp.abs(field.products[1]) * half[0] * half[2] + wp.abs(field.products[2]) * half[1] * half[2]
    c = cubic_of(field.cubes)
    x = half[0]
    y = half[1]
    z = half[2]
    cubic = x * x * (wp.abs(c[0]) * x + wp.abs(c[1]) * y + wp.abs(c[2]) * z)
    cubic = cubic + y * y * (wp.abs(c[3]) * x + wp.abs(c[6]) * y + wp.abs(c[7]) * z)
    cubic = cubic + z * z * (wp.abs(c[5]) * x + wp.abs(c[8]) * y + wp.abs(c[9]) * z) + wp.abs(c[4]) * x * y * z
    return (slope + curved + cubic) * ONE_OVER_FULL


@wp.func
def largest_share(field: Field, change: float):
    """A bound of the caps' share all over a box where it changes by no more than that."""
    most = wp.abs(float(field.value)) + field.error + wp.where(field.near > 0, field.left_out, 0.0)
    return most * ONE_OVER_FULL + change
