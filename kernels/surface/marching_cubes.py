"""Marching cubes in three launches: counts of blocks, counts of the segments that have any, vertices and triangles.

Memory beyond the map is two counts for each block of 8^3 voxels, and what grows with the surface. The order is that of
blocks, then of segments, then of edges and cells along z, on every device.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.surface.cell_cases import CENTRE
from sdm.kernels.surface.segment_cells import (
    Cases,
    above_level,
    bits_of,
    case_of,
    counts_of,
    crossings_of,
)
from sdm.kernels.surface.voxel_rows import BLOCK, SEGMENTS, Segment, Voxels, block_beyond, block_place, segment_of

# Unrolled, the cells of a segment would be eight copies of the same code.
wp.set_module_options({"enable_backward": False, "max_unroll": 4})

# Vertices stay this share of an edge away from its ends, so that those near one voxel stay apart in float32.
CLEARANCE = wp.constant(wp.float64(1.0 / 1024.0))


@wp.struct
class Surface:
    """First vertices and triangles of the segments of active blocks, and the grid in space."""

    blocks: wp.array(dtype=wp.int32)  # (n) numbers of the active blocks
    active: wp.array(dtype=wp.int32)  # the place of each block among them, plus 1
    edges: wp.array(dtype=wp.int32)  # (64 n) edges of each segment that have vertices
    first_vertex: wp.array(dtype=wp.int32)  # (64 n)
    first_triangle: wp.array(dtype=wp.int32)  # (64 n)
    origin: wp.vec3d
    axes: wp.mat33d  # columns from one voxel to the next
    mirrored: wp.int32  # 1 if the axes are left-handed


@wp.kernel
def _count_segments(begin: int, voxels: Voxels, cases: Cases, counts: wp.array(dtype=wp.int32)):
    at = begin + wp.tid()
    block = at / SEGMENTS
    line = at % SEGMENTS
    if voxels.dense != 0:
        # Neighbouring threads read neighbouring values.
        z = at % voxels.along[2]
        row = at / voxels.along[2]
        x = row / voxels.shape[1]
        y = row % voxels.shape[1]
        block = ((x / BLOCK) * voxels.along[1] + y / BLOCK) * voxels.along[2] + z
        line = BLOCK * (x % BLOCK) + y % BLOCK
    found = counts_of(voxels, cases, block, line)
    if found[0] + found[1] > 0:
        fetch_add(counts, block, found[0])
        fetch_add(counts, counts.shape[0] / 2 + block, found[1])


def count_blocks(voxels: Any, cases: Any, segments: int, counts: wp.array) -> None:
    """Add the vertices and triangles of each block to counts (2*blocks), zero before.

    Args:
        voxels: `Voxels`.
        cases: `Cases`.
        segments: 64 for each block, or of a dense map nx ny times the blocks along z.
        counts: What is added to.
    """
    launch(_count_segments, segments, [voxels, cases, counts], counts.device)


@wp.kernel
def _measure_segments(begin: int, voxels: Voxels, cases: Cases, surface: Surface, counts: wp.array(dtype=wp.int32)):
    at = begin + wp.tid()
    found = counts_of(voxels, cases, surface.blocks[at / SEGMENTS], at % SEGMENTS)
    counts[at] = found[0]
    counts[counts.shape[0] / 2 + at] = found[1]
    surface.edges[at] = found[2]


def measure_segments(voxels: Any, cases: Any, surface: Any, counts: wp.array) -> None:
    """Write the vertices and triangles of the segments of active blocks into counts (2*64n), and their edges."""
    launch(_measure_segments, counts.shape[0] // 2, [voxels, cases, surface, counts], counts.device)


@wp.func
def share_of(a: wp.float64, b: wp.float64):
    """The share of an edge at which its values, less the level, pass zero, kept away from its ends."""
    share = a / (a - b)
    # Also where values are not finite.
    if not (share > CLEARANCE):
        return CLEARANCE
    return wp.min(share, wp.float64(1.0) - CLEARANCE)


@wp.func
def edge_point(voxels: Voxels, segment: Segment, k: int, axis: int, corner: int):
    """The vertex of an edge of cell k, from its first corner, in voxels from the corner 0 of the cell."""
    step = 4 >> axis
    share = share_of(
        above_level(voxels, segment, k, corner),
        above_level(voxels, segment, k, corner + step),
    )
    at = wp.vec3d(wp.float64(corner >> 2), wp.float64((corner >> 1) & 1), wp.float64(corner & 1))
    at[axis] = share
    return at


@wp.func
def edge_corner(edge: int):
    """The first corner of a cell's edge."""
    axis = edge / 4
    n = edge % 4
    if axis == 0:
        return n
    if axis == 1:
        return (n & 1) | ((n & 2) << 1)
    return n << 1


@wp.func
def vertex_of(voxels: Voxels, surface: Surface, block: int, line: int, k: int, edge: int):
    """The number of the vertex on an edge of cell k of a segment."""
    corner = edge_corner(edge)
    i = line / BLOCK + (corner >> 2)
    j = line % BLOCK + ((corner >> 1) & 1)
    z = k + (corner & 1)
    way = 4 * (i / BLOCK) + 2 * (j / BLOCK) + z / BLOCK
    owner = surface.active[block_beyond(voxels, block, way)] - 1
    at = SEGMENTS * owner + BLOCK * (i % BLOCK) + j % BLOCK
    bit = 1 << (8 * (edge / 4) + z % BLOCK)
    return surface.first_vertex[at] + bits_of(surface.edges[at] & (bit - 1))


@wp.func
def in_space(surface: Surface, at: wp.vec3d):
    """Coordinates of a place in voxels, rounded to float32."""
    return wp.vec3(surface.origin + surface.axes * at)


@wp.kernel
def _write_surface(
    begin: int,
    voxels: Voxels,
    cases: Cases,
    surface: Surface,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
):
    at = begin + wp.tid()
    block = surface.blocks[at / SEGMENTS]
    line = at % SEGMENTS
    segment = segment_of(voxels, block, line)
    crossings = crossings_of(voxels, segment)
    place = block_place(voxels, block)
    x = wp.float64(BLOCK * place[0] + line / BLOCK)
    y = wp.float64(BLOCK * place[1] + line % BLOCK)
    z = wp.float64(BLOCK * place[2])
    vertex = surface.first_vertex[at]
    for bit in range(24):
        if ((crossings.edges >> bit) & 1) != 0:
            k = bit & 7
            inner = edge_point(voxels, segment, k, bit >> 3, 0)
            vertices[vertex] = in_space(surface, wp.vec3d(x, y, z + wp.float64(k)) + inner)
            vertex += 1
    triangle = surface.first_triangle[at]
    for k in range(8):
        if ((crossings.cells >> k) & 1) != 0:
            case = case_of(voxels, cases, segment, crossings, k)
            corner = wp.vec3d(x, y, z + wp.float64(k))
            middles = vertex
            for loop in range(4):
                if ((cases.centres[case] >> loop) & 1) != 0:
                    total = wp.vec3d()
                    count = wp.float64(0.0)
                    for edge in range(12):
                        if cases.loop[12 * case + edge] == loop:
                            total += edge_point(voxels, segment, k, edge / 4, edge_corner(edge))
                            count += wp.float64(1.0)
                    vertices[vertex] = in_space(surface, corner + total / count)
                    vertex += 1
            for number in range(cases.start[case], cases.start[case + 1]):
                face = wp.vec3i()
                for n in range(3):
                    edge = cases.triangles[3 * number + n]
                    if edge < CENTRE:
                        face[n] = vertex_of(voxels, surface, block, line, k, edge)
                    else:
                        face[n] = middles + bits_of(cases.centres[case] & ((1 << (edge - CENTRE)) - 1))
                if surface.mirrored != 0:
                    face = wp.vec3i(face[0], face[2], face[1])
                faces[triangle] = face
                triangle += 1


def write_surface(voxels: Any, cases: Any, surface: Any, vertices: wp.array, faces: wp.array) -> None:
    """Write the vertices (V,3) and faces (F,3), counter-clockwise seen from where values are larger."""
    inputs = [voxels, cases, surface, vertices, faces]
    launch(_write_surface, surface.edges.shape[0], inputs, vertices.device)
