"""Dual contouring: a vertex for each loop of a cell, where planes at its edges meet, and a quad around each edge.

The vertex minimises the sum of squared distances from the planes through the crossings of the cell's edges, square to
the normals there (Ju et al., Dual contouring of Hermite data, SIGGRAPH 2002), and so lies on sharp edges and corners.
Directions about which the planes say too little are left out, one after the other, until the vertex is in its cell.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.surface.dual_cells import CELLS, NONE, DualCells, cell_beyond, decided_case
from sdm.kernels.surface.marching_cubes import CLEARANCE, Surface, vertex_of
from sdm.kernels.surface.segment_cells import Cases
from sdm.kernels.surface.voxel_rows import BLOCK, SEGMENTS, Voxels, block_place

wp.set_module_options({"enable_backward": False, "max_unroll": 4})

LOOP_BITS = 3


@wp.struct
class Hermite:
    """Crossings of the edges, and normals there."""

    points: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    least: wp.float64  # the share of the largest eigenvalue from which a direction counts
    reach: wp.float64  # voxels by which a vertex may leave its cell for an edge or a corner
    inverse: wp.mat33d  # from space to voxels


@wp.func
def edge_of(axis: int, corner: int):
    """The number of a cell's edge from its axis and first corner."""
    if axis == 0:
        return corner
    if axis == 1:
        return 4 + ((corner & 1) | ((corner >> 1) & 2))
    return 8 + (corner >> 1)


@wp.func
def has_quad(voxels: Voxels, surface: Surface, cells: DualCells, cell: int, block: int, line: int, axis: int):
    """1 if the edge of a cell that is furthest along the other two axes is crossed amid four cells, -1 if downward."""
    inside = cells.inside[cell]
    upper = (inside >> 7) & 1
    lower = (inside >> (7 - (4 >> axis))) & 1
    if upper == lower:
        return 0
    one = 4 >> ((axis + 1) % 3)
    two = 4 >> ((axis + 2) % 3)
    for n in range(3):
        way = wp.where(n == 0, one, wp.where(n == 1, two, one + two))
        other = cell_beyond(voxels, surface, block, line, cell % BLOCK, way)
        if other == NONE:
            return 0
        if cells.inside[other] == NONE:
            return 0
    return wp.where(lower != 0, 1, -1)


@wp.kernel
def _measure_cells(
    begin: int, voxels: Voxels, cases: Cases, surface: Surface, cells: DualCells, counts: wp.array(dtype=wp.int32)
):
    at = begin + wp.tid()
    block = surface.blocks[at / SEGMENTS]
    vertices = int(0)
    triangles = int(0)
    packed = int(0)
    for k in range(8):
        cell = BLOCK * at + k
        if cells.inside[cell] > 0 and cells.inside[cell] < 255:
            case = decided_case(voxels, cases, surface, cells, cell)
            cells.cases[cell] = case
            vertices += cases.loops[case]
            packed = packed | (cases.loops[case] << (LOOP_BITS * k))
            for axis in range(3):
                if has_quad(voxels, surface, cells, cell, block, at % SEGMENTS, axis) != 0:
                    triangles += 2
    cells.loops[at] = packed
    counts[at] = vertices
    counts[counts.shape[0] / 2 + at] = triangles


def measure_cells(voxels: Any, cases: Any, surface: Any, cells: Any, counts: wp.array) -> None:
    """Write the vertices and triangles of the segments of active blocks into counts (2*64n)."""
    launch(_measure_cells, counts.shape[0] // 2, [voxels, cases, surface, cells, counts], counts.device)


@wp.func
def is_near_cell(at: wp.vec3d, reach: wp.float64):
    """True if a place in voxels from the cell's corner is in the cell, or so far beyond it along each axis."""
    low = wp.min(at[0], wp.min(at[1], at[2]))
    high = wp.max(at[0], wp.max(at[1], at[2]))
    return low >= -reach and high <= wp.float64(1.0) + reach


@wp.func
def nearest_share(start: wp.vec3d, along: wp.vec3d):
    """The share of a line's direction, nearest to 0, that leads from its start into the cell if it meets it."""
    low = wp.float64(-1.0e6)
    high = wp.float64(1.0e6)
    # A little within, so that rounding leaves the place in the cell.
    edge = wp.float64(1.5) * CLEARANCE
    for axis in range(3):
        if wp.abs(along[axis]) > wp.float64(1.0e-9):
            one = (edge - start[axis]) / along[axis]
            other = (wp.float64(1.0) - edge - start[axis]) / along[axis]
            low = wp.max(low, wp.min(one, other))
            high = wp.min(high, wp.max(one, other))
    if low > high:
        return wp.float64(0.0)
    return wp.clamp(wp.float64(0.0), low, high)


@wp.func
def loop_point(
    voxels: Voxels,
    cases: Cases,
    surface: Surface,
    hermite: Hermite,
    case: int,
    loop: int,
    block: int,
    line: int,
    k: int,
):
    """The vertex of a loop of cell k, in voxels from the cell's corner."""
    place = BLOCK * block_place(voxels, block)
    corner = surface.origin + surface.axes * wp.vec3d(
        wp.float64(place[0] + line / BLOCK), wp.float64(place[1] + line % BLOCK), wp.float64(place[2] + k)
    )
    mean = wp.vec3d()
    count = wp.float64(0.0)
    for edge in range(12):
        if cases.loop[12 * case + edge] == loop:
            mean += wp.vec3d(hermite.points[vertex_of(voxels, surface, block, line, k, edge)]) - corner
            count += wp.float64(1.0)
    mean = mean / count
    normal_matrix = wp.mat33d()
    right = wp.vec3d()
    for edge in range(12):
        if cases.loop[12 * case + edge] == loop:
            number = vertex_of(voxels, surface, block, line, k, edge)
            normal = wp.vec3d(hermite.normals[number])
            height = wp.dot(normal, wp.vec3d(hermite.points[number]) - corner - mean)
            normal_matrix += wp.outer(normal, normal)
            right += normal * height
    middle = hermite.inverse * mean
    # Rounding may have put the points of an edge beyond it.
    for axis in range(3):
        middle[axis] = wp.clamp(middle[axis], CLEARANCE, wp.float64(1.0) - CLEARANCE)
    vectors, values = wp.eig3(normal_matrix)
    # From the direction about which the planes say most to the one about which they say least.
    order = wp.vec3i(0, 1, 2)
    for n in range(3):
        at = n % 2
        if values[order[at]] < values[order[at + 1]]:
            order = wp.where(at == 0, wp.vec3i(order[1], order[0], order[2]), wp.vec3i(order[0], order[2], order[1]))
    steps = wp.mat33d()
    for n in range(3):
        vector = wp.vec3d(vectors[0, order[n]], vectors[1, order[n]], vectors[2, order[n]])
        value = values[order[n]]
        if value > hermite.least * values[order[0]]:
            vector = vector * (wp.dot(vector, right) / value)
            steps[n] = hermite.inverse * vector
    on_plane = middle + steps[0]
    on_edge = on_plane + steps[1]
    at_corner = on_edge + steps[2]
    found = middle
    has_corner = values[order[2]] > hermite.least * values[order[0]]
    has_edge = values[order[1]] > hermite.least * values[order[0]]
    if has_corner and is_near_cell(at_corner, hermite.reach):
        found = at_corner
    elif has_edge:
        along = hermite.inverse * wp.vec3d(vectors[0, order[2]], vectors[1, order[2]], vectors[2, order[2]])
        beside = on_edge + along * nearest_share(on_edge, along)
        if is_near_cell(beside, hermite.reach):
            found = beside
    elif is_near_cell(on_plane, wp.float64(0.0)):
        found = on_plane
    if not is_near_cell(found, -CLEARANCE):
        # Cells that all have the same corner next to them keep vertices of their own.
        found += wp.float64(2.0) * CLEARANCE * (middle - found)
    return found


@wp.func
def dual_vertex(cases: Cases, cells: DualCells, cell: int, edge: int):
    """The number of the vertex of a cell's loop that crosses one of its edges."""
    before = cells.loops[cell / BLOCK] & ((1 << (LOOP_BITS * (cell % BLOCK))) - 1)
    number = cells.first[cell / BLOCK] + cases.loop[12 * cells.cases[cell] + edge]
    while before != 0:
        number += before & 7
        before = before >> LOOP_BITS
    return number


@wp.kernel
def _write_vertices(
    begin: int,
    voxels: Voxels,
    cases: Cases,
    surface: Surface,
    cells: DualCells,
    hermite: Hermite,
    vertices: wp.array(dtype=wp.vec3),
):
    at = begin + wp.tid()
    if cells.loops[at] == 0:
        return
    block = surface.blocks[at / SEGMENTS]
    line = at % SEGMENTS
    place = BLOCK * block_place(voxels, block)
    vertex = int(cells.first[at])
    for k in range(8):
        for loop in range((cells.loops[at] >> (LOOP_BITS * k)) & 7):
            inner = loop_point(voxels, cases, surface, hermite, cells.cases[BLOCK * at + k], loop, block, line, k)
            corner = wp.vec3d(
                wp.float64(place[0] + line / BLOCK), wp.float64(place[1] + line % BLOCK), wp.float64(place[2] + k)
            )
            vertices[vertex] = wp.vec3(surface.origin + surface.axes * (corner + inner))
            vertex += 1


@wp.kernel
def _write_faces(
    begin: int,
    voxels: Voxels,
    cases: Cases,
    surface: Surface,
    cells: DualCells,
    hermite: Hermite,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
):
    at = begin + wp.tid()
    if cells.loops[at] == 0:
        return
    block = surface.blocks[at / SEGMENTS]
    line = at % SEGMENTS
    triangle = int(surface.first_triangle[at])
    for k in range(8):
        cell = BLOCK * at + k
        if cells.inside[cell] > 0 and cells.inside[cell] < 255:
            for axis in range(3):
                way = has_quad(voxels, surface, cells, cell, block, line, axis)
                if way != 0:
                    one = 4 >> ((axis + 1) % 3)
                    two = 4 >> ((axis + 2) % 3)
                    # Counter-clockwise around the axis; the edge begins at these corners of the four cells.
                    a = dual_vertex(cases, cells, cell, edge_of(axis, one + two))
                    right = cell_beyond(voxels, surface, block, line, k, one)
                    b = dual_vertex(cases, cells, right, edge_of(axis, two))
                    across = cell_beyond(voxels, surface, block, line, k, one + two)
                    c = dual_vertex(cases, cells, across, edge_of(axis, 0))
                    left = cell_beyond(voxels, surface, block, line, k, two)
                    d = dual_vertex(cases, cells, left, edge_of(axis, one))
                    if (way < 0) != (surface.mirrored != 0):
                        b, d = d, b
                    number = vertex_of(voxels, surface, block, line, k, edge_of(axis, one + two))
                    normal = hermite.normals[number]
                    point = hermite.points[number]
                    # The diagonal whose middle is nearer to the plane at the edge, as the one along a sharp edge is.
                    first = wp.abs(wp.dot(normal, 0.5 * (vertices[a] + vertices[c]) - point))
                    second = wp.abs(wp.dot(normal, 0.5 * (vertices[b] + vertices[d]) - point))
                    if first <= second:
                        faces[triangle] = wp.vec3i(a, b, c)
                        faces[triangle + 1] = wp.vec3i(a, c, d)
                    else:
                        faces[triangle] = wp.vec3i(a, b, d)
                        faces[triangle + 1] = wp.vec3i(b, c, d)
                    triangle += 2


def write_dual(
    voxels: Any, cases: Any, surface: Any, cells: Any, hermite: Any, vertices: wp.array, faces: wp.array
) -> None:
    """Write the vertices (V,3) and faces (F,3), counter-clockwise seen from where values are larger."""
    count, device, inputs = cells.loops.shape[0], vertices.device, [voxels, cases, surface, cells, hermite, vertices]
    launch(_write_vertices, count, inputs, device)
    launch(_write_faces, count, [*inputs, faces], device)


__all__ = ["CELLS", "DualCells", "Hermite", "measure_cells", "write_dual"]
