"""Places at which a surface crosses the edges between voxels: one for each, in the order of segments."""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.surface.marching_cubes import Surface, edge_point, in_space
from sdm.kernels.surface.segment_cells import bits_of, crossings_of
from sdm.kernels.surface.voxel_rows import BLOCK, SEGMENTS, Voxels, block_place, segment_of

wp.set_module_options({"enable_backward": False, "max_unroll": 4})


@wp.kernel
def _count_edges(begin: int, voxels: Voxels, surface: Surface, counts: wp.array(dtype=wp.int32)):
    at = begin + wp.tid()
    crossings = crossings_of(voxels, segment_of(voxels, surface.blocks[at / SEGMENTS], at % SEGMENTS))
    surface.edges[at] = crossings.edges
    counts[at] = bits_of(crossings.edges)


def count_edges(voxels: Any, surface: Any, counts: wp.array) -> None:
    """Write the edges of the segments of active blocks, and their numbers into counts (64n)."""
    launch(_count_edges, counts.shape[0], [voxels, surface, counts], counts.device)


@wp.kernel
def _write_points(
    begin: int,
    voxels: Voxels,
    surface: Surface,
    points: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
):
    at = begin + wp.tid()
    edges = surface.edges[at]
    if edges == 0:
        return
    block = surface.blocks[at / SEGMENTS]
    line = at % SEGMENTS
    segment = segment_of(voxels, block, line)
    place = BLOCK * block_place(voxels, block)
    point = surface.first_vertex[at]
    for bit in range(24):
        if ((edges >> bit) & 1) != 0:
            k = bit & 7
            axis = bit >> 3
            corner = wp.vec3d(
                wp.float64(place[0] + line / BLOCK),
                wp.float64(place[1] + line % BLOCK),
                wp.float64(place[2] + k),
            )
            points[point] = in_space(surface, corner + edge_point(voxels, segment, k, axis, 0))
            directions[point] = wp.vec3(wp.vec3d(surface.axes[0, axis], surface.axes[1, axis], surface.axes[2, axis]))
            point += 1


def write_points(voxels: Any, surface: Any, points: wp.array, directions: wp.array) -> None:
    """Write the points (V,3), and the way (V,3) from the first voxel of each one's edge to the second."""
    inputs = [voxels, surface, points, directions]
    launch(_write_points, surface.edges.shape[0], inputs, points.device)
