"""The flood of `flood_signs` through the blocks of a band and the gaps between them, with the same result.

The band is so wide that all voxels of gaps, and all neighbours of voxels in gaps, are where the ball moves freely. So a
gap is one node, and what is decided voxel by voxel is decided in blocks, from the same distances.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.flood.flood_grid import FloodGrid, is_beyond, is_in_grid, is_open, length_of
from sdm.kernels.flood.flood_nodes import FloodBlocks, neighbour_at, node_at, voxel_at
from sdm.kernels.flood.off_grid_climb import Walls, climbed, linked
from sdm.kernels.flood.reached_region import REACHED
from sdm.kernels.flood.uphill_links import STUCK, StuckVoxels, link_or_list
from sdm.kernels.geometry.block_table import VOXELS, BlockTable, voxel_of
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.union_find import merge, root_of

wp.set_module_options({"enable_backward": False})

# Threads of a GPU that share the list of voxels that climb.
MOST_THREADS = 1 << 17


@wp.kernel
def _number(begin: int, labels: wp.array(dtype=wp.int32)):
    labels[begin + wp.tid()] = begin + wp.tid()


@wp.func
def _join_row(nodes: FloodBlocks, labels: wp.array(dtype=wp.int32), number: int, x: int, y: int):
    """Merge a gap with those of another row that are beside it."""
    gap = nodes.gaps[number]
    if x >= 0 and y >= 0:
        row = x * nodes.along[1] + y
        for other in range(nodes.rows[row], nodes.rows[row + 1]):
            beside = nodes.gaps[other]
            if beside[2] < gap[3] and gap[2] < beside[3]:
                merge(labels, nodes.first_gap + number, nodes.first_gap + other)


@wp.kernel
def _join_gaps(begin: int, nodes: FloodBlocks, grid: FloodGrid, labels: wp.array(dtype=wp.int32)):
    """Merge gaps with each other, and with what is beyond the mesh's box."""
    number = begin + wp.tid()
    gap = nodes.gaps[number]
    last = wp.min(8 * wp.vec3i(gap[0] + 1, gap[1] + 1, gap[3]), grid.shape) - wp.vec3i(1, 1, 1)
    beyond = is_beyond(grid, 8 * gap[0], 8 * gap[1], 8 * gap[2]) or is_beyond(grid, last[0], last[1], last[2])
    if beyond:
        merge(labels, nodes.first_gap + number, REACHED)
    _join_row(nodes, labels, number, gap[0] - 1, gap[1])
    _join_row(nodes, labels, number, gap[0], gap[1] - 1)


@wp.kernel
def _join_voxels(
    begin: int,
    nodes: FloodBlocks,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    labels: wp.array(dtype=wp.int32),
):
    """Merge the voxels of blocks with the neighbours that the ball passes to."""
    at = 1 + begin + wp.tid()
    v = voxel_at(nodes, at)
    if not is_in_grid(grid, v[0], v[1], v[2]):
        return
    if is_beyond(grid, v[0], v[1], v[2]):
        merge(labels, at, REACHED)
    here = wp.float64(distances[at])
    if here < grid.radius:
        return
    # A bound that is a variable, so that Warp does not write the loop out.
    count = int(27)
    for place in range(count):
        step = wp.vec3i(place / 9 - 1, place / 3 % 3 - 1, place % 3 - 1)
        steps = wp.abs(step[0]) + wp.abs(step[1]) + wp.abs(step[2])
        # Far from the surface the ball comes to a diagonal neighbour by the others.
        if steps == 1 or (steps > 1 and here < grid.deep):
            if is_in_grid(grid, v[0] + step[0], v[1] + step[1], v[2] + step[2]):
                # Of two voxels in blocks the one with the smaller number is merged by the other.
                other = neighbour_at(nodes, at, v, step)
                if other < at or other >= nodes.first_gap:
                    length = length_of(grid, step[0], step[1], step[2])
                    if is_open(grid, wp.float64(distances[other]), here, length):
                        merge(labels, at, other)


@wp.kernel
def _find_roots(begin: int, labels: wp.array(dtype=wp.int32)):
    at = begin + wp.tid()
    labels[at] = root_of(labels, at)


@wp.kernel
def _link_voxels(
    begin: int,
    nodes: FloodBlocks,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    links: wp.array(dtype=wp.int32),
    stuck: StuckVoxels,
):
    at = 1 + begin + wp.tid()
    v = voxel_at(nodes, at)
    if is_in_grid(grid, v[0], v[1], v[2]):
        link_or_list(nodes, grid, distances, links, stuck, at)
    else:
        links[at] = REACHED


@wp.kernel
def _climb_listed(
    begin: int,
    walls: Walls,
    nodes: FloodBlocks,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    links: wp.array(dtype=wp.int32),
    stuck: StuckVoxels,
    step: int,
):
    place = begin + wp.tid()
    while place < stuck.count[0]:
        at = stuck.numbers[place]
        # Below zero, so that nobody takes the end of another climb for a voxel that was reached.
        links[at] = STUCK - 1 - climbed(walls, nodes, grid, distances, links, at)
        place = place + step


@wp.func
def _is_inside(links: wp.array(dtype=wp.int32), nodes: FloodBlocks, node: int):
    """True if the way uphill from a node does not end where the ball was."""
    number = node
    link = linked(links, number)
    # All of a gap is as its root is.
    while link != number and link != REACHED and number < nodes.first_gap:
        number = link
        link = linked(links, number)
    return link != REACHED


@wp.kernel
def _negate_in_blocks(
    begin: int,
    nodes: FloodBlocks,
    links: wp.array(dtype=wp.int32),
    table: BlockTable,
    shape: wp.vec3i,
    skipped: wp.vec3i,
    values: wp.array(dtype=wp.float32),
):
    number = begin + wp.tid()
    v = voxel_of(table, number)
    if v[0] < shape[0] and v[1] < shape[1] and v[2] < shape[2]:
        if _is_inside(links, nodes, node_at(nodes, v + skipped)):
            values[number] = -wp.abs(values[number])


@wp.kernel
def _look(
    begin: int,
    nodes: FloodBlocks,
    links: wp.array(dtype=wp.int32),
    voxels: wp.array(dtype=wp.vec3i),
    inside: wp.array(dtype=wp.int32),
):
    at = begin + wp.tid()
    inside[at] = wp.where(_is_inside(links, nodes, node_at(nodes, voxels[at])), 1, 0)


def flood_blocks(
    walls: Walls,
    nodes: FloodBlocks,
    grid: FloodGrid,
    distances: wp.array,
    near: wp.array,
    links: wp.array,
    stuck: StuckVoxels,
) -> None:
    """Find the link of each node; see `flood_signs`.

    Args:
        walls: The surface.
        nodes: The blocks, of N voxels, and the gaps, R. All voxels that are not further from the surface than
            `grid.deep` and the diagonal of a voxel are in blocks.
        grid: The voxels of all.
        distances: (1 + N + R,) float32 of each node, unsigned, to the mesh; of gaps no more than any of their voxels',
            as of voxels that are further away than that.
        near: The same to the mesh and what closes its small holes; may be the same array.
        links: (1 + N + R,) int32, filled.
        stuck: Workspace, with room for all N voxels.
    """
    device: Any = links.device
    voxels, gaps = VOXELS * nodes.table.blocks.shape[0], nodes.gaps.shape[0]
    launch(_number, links.shape[0], [links], device)
    launch(_join_gaps, gaps, [nodes, grid, links], device)
    launch(_join_voxels, voxels, [nodes, grid, distances, links], device)
    launch(_find_roots, links.shape[0], [links], device)
    stuck.count.zero_()
    launch(_link_voxels, voxels, [nodes, grid, near, links, stuck], device)
    workers = min(stuck.numbers.shape[0], MOST_THREADS if device.is_cuda else 16 * threads())
    inputs = [walls, nodes, grid, near, links, stuck, workers]
    launch(_climb_listed, workers, inputs, device, smallest=1)


def negate_in_blocks(
    nodes: FloodBlocks,
    links: wp.array,
    table: BlockTable,
    shape: tuple[int, int, int],
    skipped: tuple[int, int, int],
    values: wp.array,
) -> None:
    """Negate the values (N * 512) of voxels inside, of blocks of a grid that begins some voxels after the flood's."""
    inputs = [nodes, links, table, wp.vec3i(*shape), wp.vec3i(*skipped), values]
    launch(_negate_in_blocks, values.shape[0], inputs, values.device)


def are_inside(nodes: FloodBlocks, links: wp.array, voxels: wp.array, inside: wp.array) -> None:
    """Set `inside` (M,) int32 to 1 for voxels (M,) vec3i of the flood's grid that are inside, and to 0 for others."""
    launch(_look, voxels.shape[0], [nodes, links, voxels, inside], inside.device)
