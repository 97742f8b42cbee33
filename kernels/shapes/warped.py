"""Vertices of given meshes under a smooth warp, scale, rotation and shift: one thread a vertex of a sample.

The warp moves x (in units of the mesh's half-length) by d(x), d_i = A * sum_j (c_ij sin(w x_j) + e_ij cos(w x_j)).
With every |c|, |e| <= 1 the Frobenius norm of its Jacobian is at most 3 sqrt(2) A w, so an A below 1 / (3 sqrt(2) w)
makes x + d(x) a diffeomorphism of all space.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.shapes.rotation import uniform_rotation, vector_rotation
from sdm.kernels.shapes.vertex_launch import add_gradient, fill_vertices

wp.set_module_options({"enable_backward": True})

# Columns of theta: which mesh, scale, three numbers of the rotation, three of the shift, nine of c, nine of e.
WHICH, SCALE, ROTATION, SHIFT, SINES, COSINES, COLUMNS = 0, 1, 2, 5, 8, 17, 26


@wp.func
def displacement(theta: wp.array2d(dtype=float), b: int, i: int, sine: wp.vec3, cosine: wp.vec3):
    s = SINES + 3 * i
    c = COSINES + 3 * i
    odd = theta[b, s] * sine[0] + theta[b, s + 1] * sine[1] + theta[b, s + 2] * sine[2]
    even = theta[b, c] * cosine[0] + theta[b, c + 1] * cosine[1] + theta[b, c + 2] * cosine[2]
    return odd + even


@wp.kernel
def warped_kernel(
    theta: wp.array2d(dtype=float),
    rest: wp.array(dtype=wp.vec3),
    owner: wp.array(dtype=int),
    anchor: wp.array(dtype=wp.vec3),
    frame: wp.array2d(dtype=float),
    constants: wp.array(dtype=float),
    vertices: wp.array2d(dtype=wp.vec3),
):
    b, v = wp.tid()
    which = wp.clamp(int(wp.floor(theta[b, 0])), 0, anchor.shape[0] - 1)
    p = rest[v]
    # The other meshes shrink to a point of this one: their triangles lie on its surface and change nothing.
    if owner[v] != which:
        p = anchor[which]
    amplitude = constants[0]
    frequency = constants[1]
    size = frame[which, 3]
    centre = wp.vec3(frame[which, 0], frame[which, 1], frame[which, 2])
    x = (p - centre) / size
    sine = wp.vec3(wp.sin(frequency * x[0]), wp.sin(frequency * x[1]), wp.sin(frequency * x[2]))
    cosine = wp.vec3(wp.cos(frequency * x[0]), wp.cos(frequency * x[1]), wp.cos(frequency * x[2]))
    moved = x + amplitude * wp.vec3(
        displacement(theta, b, 0, sine, cosine),
        displacement(theta, b, 1, sine, cosine),
        displacement(theta, b, 2, sine, cosine),
    )
    three = wp.vec3(theta[b, ROTATION], theta[b, ROTATION + 1], theta[b, ROTATION + 2])
    rotation = uniform_rotation(three[0], three[1], three[2])
    if constants[2] > 0.0:
        rotation = vector_rotation(constants[2] * three)
    shift = wp.vec3(theta[b, SHIFT], theta[b, SHIFT + 1], theta[b, SHIFT + 2])
    turned = wp.quat_rotate(rotation, theta[b, SCALE] * moved) + shift
    placed = wp.vec3(frame[which, 4], frame[which, 5], frame[which, 6])
    vertices[b, v] = placed + frame[which, 7] * turned


def warped_vertices(theta: Any, tables: list[Any], vertices: Any, device: Any) -> None:
    """Fill `vertices` (B,V) vec3.

    Args:
        theta: (B,26) float32.
        tables: vertices of all meshes (V,) vec3; the mesh of each (V,) int32; one vertex of each mesh (M,) vec3;
            centre, half-length, new centre and new half-length of each mesh (M,8) float32; constants (3,) float32:
            the warp's amplitude and frequency, and radians for a unit of the rotation vector, 0 for a rotation from
            three uniform numbers.
        vertices: (B,V) vec3, out.
        device: Warp device.
    """
    fill_vertices(warped_kernel, theta, tables, vertices, device)


def warped_gradient(theta: Any, tables: list[Any], vertices: Any, upstream: Any, gradient: Any, device: Any) -> None:
    """Add to `gradient` (B,26) what `upstream` (B,V) vec3, the gradient by vertices, gives by theta."""
    add_gradient(warped_kernel, theta, tables, vertices, upstream, gradient, device)
