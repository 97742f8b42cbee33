"""Triangle frames: each triangle with its longest edge along x and its third corner above, the point's height apart.

Seen there, distance is a 2D problem and costs half as much as in space; and since the axes come from float64 and
are rounded once, a sliver is measured as well as any other triangle.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, load_corners
from sdm.kernels.geometry.triangle_distance import unit_normal
from sdm.kernels.launch import launch
from sdm.kernels.primitives.coalesced_stores import begin_record, end_record, floats_at, put4
from sdm.kernels.primitives.fast_math import inverse_root
from sdm.kernels.primitives.vector_loads import load4

wp.set_module_options({"enable_backward": False})

# Per triangle: (corner a, |ab|) (x axis, c_x) (y axis, c_y) (normal, 1/|bc|^2) (1/|ca|^2, solid, 0, 0).
FRAME_FLOATS = 20
_ROWS = 5


@wp.struct
class Frame:
    """A triangle (0,0), (base,0), (tip_x,tip_y) in the plane spanned by two unit vectors at a corner."""

    corner: wp.vec3
    x_axis: wp.vec3
    y_axis: wp.vec3
    normal: wp.vec3
    base: float
    tip_x: float
    tip_y: float
    inverse_bc: float
    inverse_ca: float
    solid: float  # 1, or 0 for a triangle so thin that its edges tell all


@wp.struct
class Local:
    """A point seen from a triangle: its coordinates in the frame, and the closest point of the triangle."""

    x: float
    y: float
    height: float
    near_x: float
    near_y: float


@wp.func
def load_frame(frames: wp.array(dtype=wp.float32), slot: int):
    r0 = load4(frames, _ROWS * slot)
    r1 = load4(frames, _ROWS * slot + 1)
    r2 = load4(frames, _ROWS * slot + 2)
    r3 = load4(frames, _ROWS * slot + 3)
    r4 = load4(frames, _ROWS * slot + 4)
    f = Frame()
    f.corner = wp.vec3(r0[0], r0[1], r0[2])
    f.x_axis = wp.vec3(r1[0], r1[1], r1[2])
    f.y_axis = wp.vec3(r2[0], r2[1], r2[2])
    f.normal = wp.vec3(r3[0], r3[1], r3[2])
    f.base = r0[3]
    f.tip_x = r1[3]
    f.tip_y = r2[3]
    f.inverse_bc = r3[3]
    f.inverse_ca = r4[0]
    f.solid = r4[1]
    return f


@wp.func
def is_inside(f: Frame, x: float, y: float):
    """True if (x,y) projects into the triangle."""
    left_of_bc = (f.tip_x - f.base) * y >= f.tip_y * (x - f.base)
    left_of_ca = f.tip_y * x >= f.tip_x * y
    return y >= 0.0 and left_of_bc and left_of_ca and f.solid > 0.5


@wp.func
def see(f: Frame, p: wp.vec3):
    """p in the triangle's frame, with the closest point of the triangle."""
    q = p - f.corner
    s = Local()
    s.x = wp.dot(q, f.x_axis)
    s.y = wp.dot(q, f.y_axis)
    s.height = wp.dot(q, f.normal)
    s.near_x = s.x
    s.near_y = s.y
    if not is_inside(f, s.x, s.y):
        s.near_x = wp.clamp(s.x, 0.0, f.base)
        s.near_y = 0.0
        dx = s.x - s.near_x
        best = dx * dx + s.y * s.y
        ex = f.tip_x - f.base
        px = s.x - f.base
        t = wp.clamp((px * ex + s.y * f.tip_y) * f.inverse_bc, 0.0, 1.0)
        dx = px - t * ex
        dy = s.y - t * f.tip_y
        d2 = dx * dx + dy * dy
        if d2 < best:
            best = d2
            s.near_x = f.base + t * ex
            s.near_y = t * f.tip_y
        t = wp.clamp((s.x * f.tip_x + s.y * f.tip_y) * f.inverse_ca, 0.0, 1.0)
        dx = s.x - t * f.tip_x
        dy = s.y - t * f.tip_y
        d2 = dx * dx + dy * dy
        if d2 < best:
            s.near_x = t * f.tip_x
            s.near_y = t * f.tip_y
    return s


@wp.func
def some_perpendicular(x: wp.vec3d):
    """A unit vector at right angles to a unit vector."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    other = wp.vec3d(one, zero, zero)
    if wp.abs(x[0]) > wp.float64(0.6):
        other = wp.vec3d(zero, one, zero)
    return wp.normalize(other - wp.dot(other, x) * x)


@wp.func
def exact_axes(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """The frame's axes: along ab, across it in the plane, and the normal; and whether there is a plane."""
    normal = unit_normal(a, b, c)
    solid = wp.dot(normal, normal) > wp.float64(0.5)
    x_axis = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
    base2 = wp.dot(b - a, b - a)
    if base2 > wp.float64(0.0):
        x_axis = inverse_root(base2) * (b - a)
    if not solid:
        normal = some_perpendicular(x_axis)
    return x_axis, wp.cross(normal, x_axis), normal, solid


@wp.kernel
def _make_frames(
    begin: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
):
    slot = begin + wp.tid()
    first, second, third, _normal = load_corners(tree, slot)
    a = wp.vec3d(first)
    b = wp.vec3d(second)
    c = wp.vec3d(third)
    # Begin with the corner at the start of the longest edge.
    ab2 = wp.dot(b - a, b - a)
    bc2 = wp.dot(c - b, c - b)
    ca2 = wp.dot(a - c, a - c)
    if ca2 > wp.max(ab2, bc2):
        c = wp.vec3d(second)
        a = wp.vec3d(third)
        b = wp.vec3d(first)
    elif bc2 > ab2:
        a = wp.vec3d(second)
        b = wp.vec3d(third)
        c = wp.vec3d(first)
    x_axis, y_axis, normal, solid = exact_axes(a, b, c)
    base = wp.dot(b - a, x_axis)
    tip_x = wp.dot(c - a, x_axis)
    tip_y = wp.dot(c - a, y_axis)
    if not solid:
        # Without a plane of its own the corners are on one line, whatever rounding says.
        tip_y = wp.float64(0.0)
    bc2 = (tip_x - base) * (tip_x - base) + tip_y * tip_y
    ca2 = tip_x * tip_x + tip_y * tip_y
    x = wp.vec3(x_axis)
    y = wp.vec3(y_axis)
    n = wp.vec3(normal)
    inverse_bc = wp.where(bc2 > wp.float64(0.0), float(wp.float64(1.0) / bc2), 0.0)
    inverse_ca = wp.where(ca2 > wp.float64(0.0), float(wp.float64(1.0) / ca2), 0.0)
    rows = floats_at(frames)
    record = begin_record(rows, 16 * _ROWS, slot)
    put4(record, 0, float(a[0]), float(a[1]), float(a[2]), float(base))
    put4(record, 1, x[0], x[1], x[2], float(tip_x))
    put4(record, 2, y[0], y[1], y[2], float(tip_y))
    put4(record, 3, n[0], n[1], n[2], inverse_bc)
    put4(record, 4, inverse_ca, wp.where(solid, 1.0, 0.0), 0.0, 0.0)
    end_record(rows, record, 16 * _ROWS, slot, tree.face.shape[0])


def make_frames(tree: Tree, frames: wp.array) -> None:
    """Fill `frames` (slots * FRAME_FLOATS float32) from a built tree."""
    launch(_make_frames, frames.shape[0] // FRAME_FLOATS, [tree, frames], frames.device)
