"""Vertices of simple solids: unit shapes under size, shear, rotation and shift, one thread a vertex of a sample."""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.shapes.rotation import uniform_rotation
from sdm.kernels.shapes.vertex_launch import add_gradient, fill_vertices

wp.set_module_options({"enable_backward": True})

CUBOID, RHOMBOID, ELLIPSOID, CYLINDER = 0, 1, 2, 3
# What a solid is made of: kind, three half-lengths, three shears, three numbers of the rotation, three of the shift.
SLOTS = ("kind", "x", "y", "z", "shear_xy", "shear_xz", "shear_yz", "u1", "u2", "u3", "shift_x", "shift_y", "shift_z")


@wp.func
def slot(
    theta: wp.array2d(dtype=float),
    b: int,
    column: wp.array2d(dtype=int),
    fallback: wp.array(dtype=float),
    kind: int,
    which: int,
):
    """Value of a solid's slot: a column of theta, or a constant where the kind has no column for it."""
    c = column[kind, which]
    value = fallback[which]
    if c >= 0:
        value = theta[b, c]
    return value


@wp.kernel
def solids_kernel(
    theta: wp.array2d(dtype=float),
    unit: wp.array2d(dtype=wp.vec3),
    column: wp.array2d(dtype=int),
    fallback: wp.array(dtype=float),
    vertices: wp.array2d(dtype=wp.vec3),
):
    b, v = wp.tid()
    # Every kind has the same column for the kind itself.
    kind = wp.clamp(int(wp.floor(slot(theta, b, column, fallback, 0, 0))), 0, 3)
    p = unit[kind, v]
    x = slot(theta, b, column, fallback, kind, 1) * p[0]
    y = slot(theta, b, column, fallback, kind, 2) * p[1]
    z = slot(theta, b, column, fallback, kind, 3) * p[2]
    if kind == RHOMBOID:
        xy = slot(theta, b, column, fallback, kind, 4)
        xz = slot(theta, b, column, fallback, kind, 5)
        yz = slot(theta, b, column, fallback, kind, 6)
        x = x + xy * y + xz * z
        y = y + yz * z
    u1 = slot(theta, b, column, fallback, kind, 7)
    u2 = slot(theta, b, column, fallback, kind, 8)
    u3 = slot(theta, b, column, fallback, kind, 9)
    shift = wp.vec3(
        slot(theta, b, column, fallback, kind, 10),
        slot(theta, b, column, fallback, kind, 11),
        slot(theta, b, column, fallback, kind, 12),
    )
    vertices[b, v] = wp.quat_rotate(uniform_rotation(u1, u2, u3), wp.vec3(x, y, z)) + shift


def solids_vertices(theta: Any, tables: list[Any], vertices: Any, device: Any) -> None:
    """Fill `vertices` (B,V) vec3.

    Args:
        theta: (B,P) float32.
        tables: unit shapes (4,V) vec3; column of theta for each kind and slot (4,13) int32, -1 for none; what a slot
            without a column holds (13,) float32.
        vertices: (B,V) vec3, out.
        device: Warp device.
    """
    fill_vertices(solids_kernel, theta, tables, vertices, device)


def solids_gradient(theta: Any, tables: list[Any], vertices: Any, upstream: Any, gradient: Any, device: Any) -> None:
    """Add to `gradient` (B,P) what `upstream` (B,V) vec3, the gradient by vertices, gives by theta."""
    add_gradient(solids_kernel, theta, tables, vertices, upstream, gradient, device)
