"""Vertices of cochleae from their four parameters: one thread a vertex of a sample."""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.shapes.vertex_launch import add_gradient, fill_vertices

wp.set_module_options({"enable_backward": True})

TURN = 6.283185307179586


@wp.func
def soft_min(x: float, y: float):
    """Smooth minimum of two positive numbers, never above either: the 12-norm of their inverses, inverted."""
    q = x / y
    q3 = q * q * q
    q6 = q3 * q3
    return x * wp.pow(1.0 + q6 * q6, -1.0 / 12.0)


@wp.func
def fade(r: float, length: float):
    """Near 1 for r far above `length`, near r / length far below."""
    return r / wp.sqrt(r * r + length * length)


@wp.kernel
def cochlea_kernel(
    theta: wp.array2d(dtype=float),
    stations: wp.array2d(dtype=float),
    station: wp.array(dtype=int),
    section: wp.array(dtype=wp.vec2),
    constants: wp.array(dtype=float),
    vertices: wp.array2d(dtype=wp.vec3),
):
    b, v = wp.tid()
    s = station[v]
    t = stations[s, 0]
    rise = constants[0]
    phase = constants[1]
    fading = constants[2]
    inner = constants[3]
    share = constants[4]
    power = constants[5]

    spiral = theta[b, 0] * wp.exp(-theta[b, 2] * t)
    r = spiral * stations[s, 1]
    turn = wp.exp(-theta[b, 2] * TURN)
    wave = theta[b, 1] * wp.cos(t - theta[b, 3] - phase)
    here = wave * fade(spiral, fading)
    z = rise * t + here
    # Height between this turn and the next, and the one before.
    above = rise * TURN + wave * fade(spiral * turn, fading) - here
    below = rise * TURN + here - wave * fade(spiral / turn, fading)

    size = wp.pow(spiral, power)
    width = soft_min(stations[s, 2] * size, inner * r)
    top = soft_min(soft_min(stations[s, 3] * size, share * above), width)
    bottom = soft_min(soft_min(stations[s, 4] * size, share * below), width)

    unit = section[v]
    u = width * unit[0]
    height = top
    if unit[1] < 0.0:
        height = bottom
    rho = r + u
    vertices[b, v] = wp.vec3(rho * stations[s, 6], rho * stations[s, 7], z + height * unit[1] + stations[s, 5] * u)


def cochlea_vertices(theta: Any, tables: list[Any], vertices: Any, device: Any) -> None:
    """Fill `vertices` (B,V) vec3.

    Args:
        theta: (B,4) float32: a [mm], alpha [mm], b [1/rad], phi [rad].
        tables: stations (S,8) float32: turning angle [rad], hook factor, half-width, height above and below the
            centre line [mm^(1 - power)], slope, cosine and sine of the angle; the station of each vertex (V,) int32;
            its place in the unit section (V,) vec2; constants (6,) float32: rise [mm/rad], phase [rad], fading
            radius [mm], largest half-width [r], largest height [room to the next turn], power.
        vertices: (B,V) vec3 [mm], out.
        device: Warp device.
    """
    fill_vertices(cochlea_kernel, theta, tables, vertices, device)


def cochlea_gradient(theta: Any, tables: list[Any], vertices: Any, upstream: Any, gradient: Any, device: Any) -> None:
    """Add to `gradient` (B,4) what `upstream` (B,V) vec3, the gradient by vertices, gives by theta."""
    add_gradient(cochlea_kernel, theta, tables, vertices, upstream, gradient, device)
