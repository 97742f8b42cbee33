"""Rotations from three numbers, as unit quaternions."""

from __future__ import annotations

import warp as wp

TURN = 6.283185307179586
# Keeps the gradient of the square root finite at the ends of the range.
SMALLEST = 1.0e-12


@wp.func
def uniform_rotation(u1: float, u2: float, u3: float):
    """Uniform over all rotations for uniform numbers in (0,1): Shoemake, Graphics Gems III, 1992."""
    inner = wp.sqrt(wp.max(1.0 - u1, SMALLEST))
    outer = wp.sqrt(wp.max(u1, SMALLEST))
    second = TURN * u2
    third = TURN * u3
    return wp.quat(inner * wp.sin(second), inner * wp.cos(second), outer * wp.sin(third), outer * wp.cos(third))


@wp.func
def vector_rotation(v: wp.vec3):
    """Turn by |v| radians about v; smooth at zero."""
    square = wp.dot(v, v)
    share = 0.5 - square / 48.0
    real = 1.0 - square / 8.0
    if square > 1.0e-4:
        angle = wp.sqrt(square)
        share = wp.sin(0.5 * angle) / angle
        real = wp.cos(0.5 * angle)
    return wp.quat(share * v[0], share * v[1], share * v[2], real)
