"""Edge-connected components of a mesh's faces, and what each encloses: union-find over the pairing of faces."""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import add_double
from sdm.kernels.primitives.union_find import merge, root_of

wp.set_module_options({"enable_backward": False})

# Sums of a component: its corners, its faces' cross products, the triple products, the lengths of the cross products,
# and how many faces there are.
CORNERS, NORMALS, VOLUME, AREA, COUNT, SUMS = 0, 3, 6, 7, 8, 9
# Neighbouring faces that one thread adds up before it tells the others.
CPU_RUN, GPU_RUN = 2048, 16


@wp.kernel
def _start(begin: int, parent: wp.array(dtype=wp.int32)):
    face = begin + wp.tid()
    parent[face] = face


@wp.kernel
def _join(begin: int, neighbours: wp.array2d(dtype=wp.int32), parent: wp.array(dtype=wp.int32)):
    face = begin + wp.tid()
    for k in range(3):
        # Faces at an edge are in ascending order: that the last leads back to the first joins nothing.
        other = neighbours[face, k] / 3
        if other > face:
            merge(parent, face, other)


@wp.kernel
def _clear(begin: int, parent: wp.array(dtype=wp.int32), sums: wp.array(dtype=wp.float64)):
    face = begin + wp.tid()
    root = root_of(parent, face)
    parent[face] = root
    if root == face:
        for k in range(SUMS):
            sums[SUMS * face + k] = wp.float64(0.0)


@wp.func
def _tell(sums: wp.array(dtype=wp.float64), root: int, corners: wp.vec3d, normals: wp.vec3d, others: wp.vec3d):
    at = SUMS * root
    for k in range(3):
        add_double(sums, at + CORNERS + k, corners[k])
        add_double(sums, at + NORMALS + k, normals[k])
        add_double(sums, at + VOLUME + k, others[k])


@wp.kernel
def _add_up(
    begin: int,
    run: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    parent: wp.array(dtype=wp.int32),
    sums: wp.array(dtype=wp.float64),
):
    first = (begin + wp.tid()) * run
    root = int(-1)
    corners = wp.vec3d()
    normals = wp.vec3d()
    others = wp.vec3d()
    middle = wp.vec3d()
    for face in range(first, wp.min(first + run, faces.shape[0])):
        if parent[face] != root:
            if root >= 0:
                _tell(sums, root, corners, normals, others)
            root = parent[face]
            # Near the component, so that far from the origin no digits are lost.
            middle = wp.vec3d(vertices[faces[root, 0]])
            corners = wp.vec3d()
            normals = wp.vec3d()
            others = wp.vec3d()
        a = wp.vec3d(vertices[faces[face, 0]]) - middle
        b = wp.vec3d(vertices[faces[face, 1]]) - middle
        c = wp.vec3d(vertices[faces[face, 2]]) - middle
        normal = wp.cross(b - a, c - a)
        corners += a + b + c
        normals += normal
        others += wp.vec3d(wp.dot(a, normal), wp.length(normal), wp.float64(1.0))
    if root >= 0:
        _tell(sums, root, corners, normals, others)


@wp.kernel
def _judge(
    begin: int,
    least: wp.float64,
    parent: wp.array(dtype=wp.int32),
    sums: wp.array(dtype=wp.float64),
    flag: wp.array(dtype=wp.int32),
):
    face = begin + wp.tid()
    if parent[face] != face:
        return
    at = SUMS * face
    volume = sums[at + VOLUME]
    for k in range(3):
        middle = sums[at + CORNERS + k] / (wp.float64(3.0) * sums[at + COUNT])
        volume = volume - middle * sums[at + NORMALS + k]
    area = wp.float64(0.5) * sums[at + AREA]
    # Not "<=": what is not a number is not enough.
    if not (volume / wp.float64(6.0) > least * area * wp.sqrt(area)):
        flag[0] = 1


def judge_components(
    vertices: wp.array,
    faces: wp.array,
    neighbours: wp.array,
    least: float,
    parent: wp.array,
    sums: wp.array,
    flag: wp.array,
) -> None:
    """Set `flag` if a component encloses no more than a share of what its area could.

    Args:
        vertices: (V) vec3.
        faces: (F,3) int32, all within range.
        neighbours: (F,4) int32 of `pair_edges`: 3 times a face and less than 3 more, or -1.
        least: The share of its area to the power of 3/2 that each component's signed volume has to exceed. That of
            an open one is about the middle of its corners.
        parent: (F) int32, afterwards each face's root.
        sums: (SUMS * F) float64, workspace.
        flag: (1) int32, zero; afterwards 1 if a component falls short.
    """
    count, device = faces.shape[0], faces.device
    run = GPU_RUN if device.is_cuda else CPU_RUN
    launch(_start, count, [parent], device)
    launch(_join, count, [neighbours, parent], device)
    launch(_clear, count, [parent, sums], device)
    launch(_add_up, -(-count // run), [run, vertices, faces, parent, sums], device, smallest=1)
    launch(_judge, count, [least, parent, sums, flag], device)
