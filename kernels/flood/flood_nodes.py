"""Nodes of a flood, by number: the voxels of a grid, or those of a narrow band's blocks and the runs between blocks.

Functions of one name take either (`nodes`), so that a flood through a band is the flood through the grid.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.flood.flood_grid import FloodGrid, number_of
from sdm.kernels.geometry.block_table import VOXELS, BlockTable, inner_of, place_of, voxel_of

wp.set_module_options({"enable_backward": False})


@wp.struct
class FloodBlocks:
    """A band: node 0 is what is beyond the mesh's box, then come the voxels of blocks, then the gaps.

    A gap is a run along z of blocks that are not there. All of its voxels are so far from the surface that the ball
    moves freely from one to the next.
    """

    table: BlockTable
    gaps: wp.array(dtype=wp.vec4i)  # (R) x and y, the first z, one after the last; sorted as blocks are
    rows: wp.array(dtype=wp.int32)  # (along[0] * along[1] + 1), the place of a row's first gap
    along: wp.vec2i  # blocks of the grid along x and y
    first_gap: wp.int32  # its node


@wp.func
def node_at(nodes: FloodGrid, v: wp.vec3i):
    """The node of a voxel."""
    return number_of(nodes, v[0], v[1], v[2])


@wp.func
def node_at(nodes: FloodBlocks, v: wp.vec3i):  # noqa: F811
    block = wp.vec3i(v[0] >> 3, v[1] >> 3, v[2] >> 3)
    place = place_of(nodes.table, block)
    if place >= 0:
        return 1 + VOXELS * place + inner_of(v)
    row = block[0] * nodes.along[1] + block[1]
    low = nodes.rows[row]
    high = nodes.rows[row + 1]
    # The last one that begins at the block or before it.
    while low + 1 < high:
        middle = (low + high) / 2
        if nodes.gaps[middle][2] <= block[2]:
            low = middle
        else:
            high = middle
    return nodes.first_gap + low


@wp.func
def voxel_at(nodes: FloodGrid, node: int):
    """The voxel of a node that has one."""
    row = node / nodes.shape[2]
    return wp.vec3i(row / nodes.shape[1], row % nodes.shape[1], node % nodes.shape[2])


@wp.func
def voxel_at(nodes: FloodBlocks, node: int):  # noqa: F811
    return voxel_of(nodes.table, node - 1)


@wp.func
def neighbour_at(nodes: FloodGrid, node: int, v: wp.vec3i, step: wp.vec3i):
    """The node of a voxel's neighbour, which is in the grid."""
    return number_of(nodes, v[0] + step[0], v[1] + step[1], v[2] + step[2])


@wp.func
def neighbour_at(nodes: FloodBlocks, node: int, v: wp.vec3i, step: wp.vec3i):  # noqa: F811
    there = v + step
    if there[0] >> 3 == v[0] >> 3 and there[1] >> 3 == v[1] >> 3 and there[2] >> 3 == v[2] >> 3:
        return node + 64 * step[0] + 8 * step[1] + step[2]
    return node_at(nodes, there)
