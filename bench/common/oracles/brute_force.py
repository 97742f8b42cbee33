"""The float64 brute force as Warp kernels, for millions of points: tests/helpers/oracle.py again, on a CPU or a GPU.

One thread goes over all triangles for one point. A triangle whose bounding sphere is further away than the best so far
is passed over; every other one is measured in full.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

# Below this share of its longest edge a triangle's width leaves its plane without digits; its edges then do for it.
NARROWEST = wp.float64(1e-11)
TURN = wp.float64(2 * np.pi)
# One launch takes this many points, so that progress shows and no launch runs for long.
CHUNK = 1 << 18


@wp.func
def _from_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.vec3d:
    edge = b - a
    to_point = p - a
    squared = wp.dot(edge, edge)
    along = wp.float64(0.0)
    if squared > wp.float64(0.0):
        along = wp.clamp(wp.dot(to_point, edge) / squared, wp.float64(0.0), wp.float64(1.0))
    return to_point - along * edge


@wp.func
def _unit(v: wp.vec3d, length: wp.float64) -> wp.vec3d:
    result = v
    if length > wp.float64(0.0):
        result = v / length
    return result


# From the closest point of a triangle to `p`. The frame on the longest edge a-b keeps a sliver's plane from tilting.
@wp.func
def _from_triangle(p: wp.vec3d, i: wp.vec3d, j: wp.vec3d, k: wp.vec3d) -> wp.vec3d:
    ij = wp.length_sq(j - i)
    jk = wp.length_sq(k - j)
    ki = wp.length_sq(i - k)
    a = i
    b = j
    c = k
    if jk > ij and jk >= ki:
        a = j
        b = k
        c = i
    elif ki > ij and ki > jk:
        a = k
        b = i
        c = j
    length = wp.sqrt(wp.max(ij, wp.max(jk, ki)))
    x = _unit(b - a, length)
    rise = c - a
    top = wp.dot(rise, x)
    across = rise - top * x
    across = across - wp.dot(across, x) * x
    height = wp.length(across)
    y = _unit(across, height)
    y = y - wp.dot(y, x) * x
    to_point = p - a
    px = wp.dot(to_point, x)
    py = wp.dot(to_point, y)
    best = _from_segment(p, a, b)
    other = _from_segment(p, b, c)
    if wp.length_sq(other) < wp.length_sq(best):
        best = other
    other = _from_segment(p, c, a)
    if wp.length_sq(other) < wp.length_sq(best):
        best = other
    if (
        height > NARROWEST * length
        and py >= wp.float64(0.0)
        and height * px >= top * py
        and height * (length - px) >= (length - top) * py
    ):
        other = to_point - px * x - py * y
        if wp.length_sq(other) < wp.length_sq(best):
            best = other
    return best


@wp.kernel(enable_backward=False)
def _distance_kernel(
    corner: wp.array2d[wp.vec3d],
    centre: wp.array[wp.vec3d],
    radius: wp.array[wp.float64],
    points: wp.array[wp.vec3d],
    begin: int,
    distance: wp.array[wp.float64],
    closest: wp.array[wp.vec3d],
    face: wp.array[wp.int32],
):
    n = begin + wp.tid()
    p = points[n]
    best = wp.float64(wp.inf)
    squared = wp.float64(wp.inf)
    offset = wp.vec3d()
    winner = wp.int32(-1)
    for f in range(corner.shape[0]):
        reach = best + radius[f]
        if wp.length_sq(p - centre[f]) <= reach * reach:
            r = _from_triangle(p, corner[f, 0], corner[f, 1], corner[f, 2])
            here = wp.length_sq(r)
            if here < squared:
                squared = here
                best = wp.sqrt(here)
                offset = r
                winner = f
    distance[n] = best
    closest[n] = p - offset
    face[n] = winner


@wp.kernel(enable_backward=False)
def _winding_kernel(
    corner: wp.array2d[wp.vec3d], points: wp.array[wp.vec3d], begin: int, winding: wp.array[wp.float64]
):
    n = begin + wp.tid()
    p = points[n]
    total = wp.float64(0.0)
    for f in range(corner.shape[0]):
        a = corner[f, 0] - p
        b = corner[f, 1] - p
        c = corner[f, 2] - p
        la = wp.length(a)
        lb = wp.length(b)
        lc = wp.length(c)
        divisor = la * lb * lc + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb
        total += wp.atan2(wp.dot(a, wp.cross(b, c)), divisor)
    winding[n] = total / TURN


@wp.kernel(enable_backward=False)
def _one_face_kernel(
    corner: wp.array2d[wp.vec3d],
    face: wp.array[wp.int32],
    points: wp.array[wp.vec3d],
    begin: int,
    distance: wp.array[wp.float64],
):
    n = begin + wp.tid()
    f = face[n]
    distance[n] = wp.length(_from_triangle(points[n], corner[f, 0], corner[f, 1], corner[f, 2]))


class Brute:
    """Every triangle of a mesh for every point, in float64.

    Args:
        vertices: (V,3) coordinates.
        faces: (F,3) vertex indices.
        device: `"cpu"` or `"cuda"`; on the CPU all cores share the points.
        progress: Called with the share done, 0 to 1, between launches.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        device: str = "cpu",
        progress: Callable[[float], None] = lambda _: None,
    ) -> None:
        corner = np.asarray(vertices, np.float64)[np.asarray(faces)]
        centre = corner.mean(1)
        # Rounded up: a sphere a little too large passes over nothing that counts.
        radius = np.linalg.norm(corner - centre[:, None], axis=-1).max(1) * (1 + 1e-9) + 1e-13 * np.abs(centre).max()
        self.device, self._progress = device, progress
        self._corner = wp.array(corner, dtype=wp.vec3d, device=device)
        self._centre = wp.array(centre, dtype=wp.vec3d, device=device)
        self._radius = wp.array(radius, dtype=wp.float64, device=device)
        wp.load_module(device=device)

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (N,), closest points (N,3) and faces (N,), as `tests.helpers.oracle.distance`."""
        at = self._points(points)
        out = self._empty(at, wp.float64), self._empty(at, wp.vec3d), self._empty(at, wp.int32)
        self._launch(_distance_kernel, at, [self._corner, self._centre, self._radius, at], out)
        return out[0].numpy(), out[1].numpy(), out[2].numpy()

    def winding_number(self, points: np.ndarray) -> np.ndarray:
        """Generalised winding numbers (N,), as `tests.helpers.oracle.winding_number`."""
        at = self._points(points)
        out = self._empty(at, wp.float64)
        self._launch(_winding_kernel, at, [self._corner, at], (out,))
        return out.numpy()

    def distance_to_face(self, points: np.ndarray, face: np.ndarray) -> np.ndarray:
        """Distance (N,) of each point from one face: `face[n]` for `points[n]`."""
        at = self._points(points)
        out = self._empty(at, wp.float64)
        which = wp.array(np.asarray(face, np.int32), dtype=wp.int32, device=self.device)
        self._launch(_one_face_kernel, at, [self._corner, which, at], (out,))
        return out.numpy()

    def _points(self, points: np.ndarray) -> wp.array:
        return wp.array(np.asarray(points, np.float64).reshape(-1, 3), dtype=wp.vec3d, device=self.device)

    def _empty(self, like: wp.array, dtype: Any) -> wp.array:
        return wp.empty(like.shape[0], dtype=dtype, device=self.device)

    def _launch(self, kernel: wp.Kernel, points: wp.array, inputs: list[Any], outputs: tuple[wp.array, ...]) -> None:
        count = points.shape[0]
        workers = 1 if wp.get_device(self.device).is_cuda else max(1, len(os.sched_getaffinity(0)))
        step = CHUNK if workers == 1 else min(CHUNK, max(64, count // (8 * workers)))

        def launch(begin: int) -> None:
            dim = min(step, count - begin)
            wp.launch(kernel, dim=dim, inputs=[*inputs, begin], outputs=list(outputs), device=self.device)
            if workers == 1:
                wp.synchronize_device(self.device)

        begins = range(0, count, step)
        # A launch on the CPU runs on one thread and lets go of Python's lock meanwhile.
        with ThreadPoolExecutor(workers) as pool:
            for done, _ in enumerate(pool.map(launch, begins), 1):
                self._progress(done / len(begins))
