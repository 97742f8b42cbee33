"""Regions, cells and bricks of voxels: the boxes that the stages of the dense query work on.

A cell has 8^3 voxels, a region 2^3 cells, and a brick is an eighth of a cell. Where the candidate lists of larger cells
are short as well, cells have 16^3 voxels, and their bricks, which then have 8^3, are measured from one list. On a small
grid they have 4^3, and no bricks.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import DIAGONAL, FRAME_SIZE, REACH, SCALE, Tree
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_voxels, octant_at
from sdm.kernels.geometry.voxel_grid import REGION, SLAB_ROW, Slab, mesh_in_rows, slab_of, unravel

wp.set_module_options({"enable_backward": False})

# Voxels along the edge of the largest block that is measured at a time.
BLOCK = 8
# Half-width of a box of voxels, in units of the mesh's largest coordinate, beyond which it is not measured as a whole:
# errors are up to 3.3 roundings with a fifth, 3.9 with a quarter (bench/decisions/0057-frames-of-small-maps.md).
COARSEST = 0.2


@wp.struct
class RegionGrid:
    """Regions of one pass, and the cells that they are divided into."""

    regions: wp.vec3i  # regions along each axis of the slab that all meshes have
    first: wp.int32  # first region of this pass, counting through the meshes
    step: wp.int32  # from it to the next
    count: wp.int32  # regions of this pass
    cell: wp.int32  # voxels along the edge of a cell: 4, 8 or 16
    by_brick: wp.int32  # 1 if bricks of cells of 16^3 voxels have lists of their own


@wp.func
def make_cell(tree: Tree, slab: Slab, mesh: int, start: wp.vec3i, size: int):
    """The box of `size`^3 voxels from `start`, to be compared with a mesh's surface points."""
    frame = mesh * FRAME_SIZE
    cell = box_of_voxels(slab_of(slab, mesh), start, size, float(tree.frame[frame + SCALE]))
    cell.diagonal = float(tree.frame[frame + DIAGONAL])
    return cell


@wp.func
def is_coarse(tree: Tree, mesh: int, cell: VoxelBox):
    """True if a box is so wide beside a mesh that float32 rounds a place in it too much."""
    return wp.max(cell.half) > COARSEST * float(tree.frame[mesh * FRAME_SIZE + REACH])


@wp.func
def region_start(slab: Slab, grid: RegionGrid, item: int):
    """The mesh, and the first voxel, of a region."""
    number = grid.first + item * grid.step
    if slab.meshes > 0:
        owner = mesh_in_rows(slab, REGION, number)
        edge = 2 * grid.cell
        regions = (slab_of(slab, owner).shape + wp.vec3i(edge - 1, edge - 1, edge - 1)) / edge
        _none, there = unravel(number - int(slab.rows[owner * SLAB_ROW + REGION]), regions)
        return owner, edge * there
    mesh, at = unravel(number, grid.regions)
    return mesh, 2 * grid.cell * at


@wp.func
def own_shares(slab: Slab, mesh: int, entry: int, shares: int):
    """Shares that a mesh's lists are made in, of as many as there is room for; `entry`: of regions' or cells'."""
    own = shares
    if slab.meshes > 0:
        own = int(slab.rows[mesh * SLAB_ROW + entry])
    return own


@wp.func
def cell_start(grid: RegionGrid, start: wp.vec3i, item: int):
    """The first voxel of cell `item` % 8 of a region that starts there."""
    return start + grid.cell * octant_at(item)


@wp.func
def brick_start(grid: RegionGrid, start: wp.vec3i, item: int):
    """The first voxel of brick `item` % 8 of a cell that starts there."""
    return start + (grid.cell / 2) * octant_at(item)


@wp.func
def brick_number(grid: RegionGrid, number: int, octant: int):
    """The number of a cell's brick, in one count with the cells."""
    return 8 * grid.count + 8 * number + octant
