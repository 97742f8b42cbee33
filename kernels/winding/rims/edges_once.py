"""Boundary edges between faces that do not agree stand twice, next to each other: each of them once.

Where all do, sums over edges and the strips that a voxel is near are half as many.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.launch import launch, new_zeros, set_array
from sdm.kernels.winding.boundary_term import Boundary, edges_of

wp.set_module_options({"enable_backward": False})

# Places of the numbers: 1 if some edge is alone; edges that are left, and how often each counts.
SINGLE, LEFT, TIMES, NUMBERS = 0, 1, 2, 3


@wp.kernel
def _compare(begin: int, boundary: Boundary, numbers: wp.array(dtype=wp.int32)):
    i = begin + wp.tid()
    pairs = (boundary.count + 1) / 2
    mesh = i / pairs
    e = 2 * (i - mesh * pairs)
    count = edges_of(boundary)
    if e >= count:
        return
    if e + 1 == count:
        numbers[SINGLE] = 1
        return
    at = 2 * (mesh * boundary.count + e)
    if not (boundary.ends[at] == boundary.ends[at + 2] and boundary.ends[at + 1] == boundary.ends[at + 3]):
        numbers[SINGLE] = 1


@wp.kernel
def _take(begin: int, boundary: Boundary, numbers: wp.array(dtype=wp.int32), ends: wp.array(dtype=wp.vec3)):
    i = begin + wp.tid()
    times = wp.where(numbers[SINGLE] != 0, 1, 2)
    left = edges_of(boundary) / times
    if i == 0:
        numbers[LEFT] = left
        numbers[TIMES] = times
    mesh = i / boundary.count
    e = i - mesh * boundary.count
    if e < left:
        at = 2 * (mesh * boundary.count + times * e)
        ends[2 * i] = boundary.ends[at]
        ends[2 * i + 1] = boundary.ends[at + 1]


def edges_once(boundary: Boundary, meshes: int, empty: Callable[[int, Any], wp.array]) -> tuple[Any, wp.array]:
    """A boundary of each mesh's edges, and (1) int32 how often each of them counts: 2 if all stand twice, else 1.

    It has no places on the lattice, so sums in float64 are not for it.
    """
    device = boundary.ends.device
    numbers: Any = new_zeros(empty, NUMBERS)
    ends = empty(2 * meshes * boundary.count, wp.vec3)
    launch(_compare, meshes * ((boundary.count + 1) // 2), [boundary, numbers], device)
    launch(_take, meshes * boundary.count, [boundary, numbers, ends], device)
    once: Any = Boundary()
    set_array(once, "ends", ends)
    set_array(once, "counted", numbers[LEFT : LEFT + 1])
    once.count, once.in_room = boundary.count, 1
    return once, numbers[TIMES : TIMES + 1]
