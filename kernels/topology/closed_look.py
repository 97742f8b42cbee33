"""One look at a mesh on the host: is each edge of two faces that agree, and does every component face outward?

By one thread and in one launch, where the pairing of faces (`edge_pairing.py`) and the volumes of components take nine:
beside other threads each launch gives up Python's lock and waits to have it back. It says yes or nothing: whatever is
not as plain as that is left to them.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.primitives.union_find import merge, root_of

wp.set_module_options({"enable_backward": False})

# Numbers of a component: its volume and area, six and two times.
VOLUME, AREA, SUMS = 0, 1, 2
# What the slot of an edge holds once its second face was there.
MATCHED = -1
# Places that are looked at for an edge; a vertex of more edges may need them.
MOST_PROBES = 64


@wp.func
def _pair_faces(
    vertices: int,
    faces: wp.array2d(dtype=wp.int32),
    keys: wp.array(dtype=wp.int64),
    waiting: wp.array(dtype=wp.int32),
    parent: wp.array(dtype=wp.int32),
):
    """True if each edge belongs to two faces, once in each direction; joins them."""
    slots = keys.shape[0]
    apart = wp.max(1, slots / vertices)
    for slot in range(slots):
        keys[slot] = wp.int64(-1)
    for face in range(faces.shape[0]):
        parent[face] = face
    distinct = int(0)
    unmatched = int(0)
    for edge in range(3 * faces.shape[0]):
        start = faces[edge / 3, edge % 3]
        end = faces[edge / 3, (edge + 1) % 3]
        if start == end or wp.min(start, end) < 0 or wp.max(start, end) >= vertices:
            return False
        key = (wp.int64(wp.min(start, end)) << wp.int64(32)) | wp.int64(wp.max(start, end))
        # Near the place of one end, which a bit that mixes both chooses: edges of vertices that follow each other lie
        # beside each other, as faces mostly come, and no vertex has many more than others.
        mixed = (wp.min(start, end) * 40503 + wp.max(start, end) * 30011) >> 7
        near = wp.where(mixed % 2 == 0, wp.min(start, end), wp.max(start, end))
        slot = (near * apart + wp.abs(mixed) % apart) & (slots - 1)
        probes = int(0)
        while keys[slot] != key and keys[slot] >= wp.int64(0):
            slot = (slot + 1) & (slots - 1)
            probes += 1
            if probes > MOST_PROBES:
                return False
        if keys[slot] < wp.int64(0):
            distinct += 1
            # More are not all matched, and would fill the table.
            if 2 * distinct > 3 * faces.shape[0]:
                return False
            keys[slot] = key
            # Twice the face, and one more if it goes up.
            waiting[slot] = 2 * (edge / 3) + wp.where(start < end, 1, 0)
            unmatched += 1
        else:
            first = waiting[slot]
            if first == MATCHED or first % 2 == wp.where(start < end, 1, 0):
                return False
            merge(parent, first / 2, edge / 3)
            waiting[slot] = MATCHED
            unmatched -= 1
    return unmatched == 0


@wp.kernel
def _look(
    begin: int,
    least: wp.float64,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    keys: wp.array(dtype=wp.int64),
    waiting: wp.array(dtype=wp.int32),
    parent: wp.array(dtype=wp.int32),
    sums: wp.array(dtype=wp.float64),
    plain: wp.array(dtype=wp.int32),
):
    plain[0] = 0
    if not _pair_faces(vertices.shape[0], faces, keys, waiting, parent):
        return
    for k in range(sums.shape[0]):
        sums[k] = wp.float64(0.0)
    for face in range(faces.shape[0]):
        root = root_of(parent, face)
        # Near the component, so that far from the origin no digits are lost.
        middle = wp.vec3d(vertices[faces[root, 0]])
        a = wp.vec3d(vertices[faces[face, 0]]) - middle
        b = wp.vec3d(vertices[faces[face, 1]]) - middle
        c = wp.vec3d(vertices[faces[face, 2]]) - middle
        normal = wp.cross(b - a, c - a)
        sums[SUMS * root + VOLUME] += wp.dot(a, normal)
        sums[SUMS * root + AREA] += wp.length(normal)
    for face in range(faces.shape[0]):
        if parent[face] == face:
            area = wp.float64(0.5) * sums[SUMS * face + AREA]
            # Not "<=": what is not a number is not enough.
            if not (sums[SUMS * face + VOLUME] / wp.float64(6.0) > least * area * wp.sqrt(area)):
                return
    plain[0] = 1


def slots_for(faces: int) -> int:
    """Places of the table of edges: a power of two, so that three edges for two faces fill at most two thirds."""
    return 1 << (9 * faces // 4).bit_length()


def look_whether_closed(
    vertices: wp.array,
    faces: wp.array,
    least: float,
    keys: wp.array,
    waiting: wp.array,
    parent: wp.array,
    sums: wp.array,
    plain: wp.array,
) -> None:
    """Set `plain` to 1 if a mesh on the host is closed and each component encloses more than a share of what it could.

    Args:
        vertices: (V) vec3.
        faces: (F,3) int32.
        least: The share of a component's area to the power of 3/2 that its signed volume has to exceed.
        keys: (S) int64, workspace, of `slots_for(F)` places or more, a power of two.
        waiting: (S) int32, workspace.
        parent: (F) int32, workspace.
        sums: (SUMS * F) float64, workspace.
        plain: (1) int32.
    """
    inputs: list[Any] = [least, vertices, faces, keys, waiting, parent, sums, plain]
    launch(_look, 1, inputs, vertices.device)
