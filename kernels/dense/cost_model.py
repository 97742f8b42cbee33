"""Cost model: expected work and memory of a map, and what follows for how it is computed.

All of it from numbers of triangles and voxels, so that every slab of a grid, and every map of a batch, is treated in
the same way.
"""
# pyright: basic

from __future__ import annotations

import math
from collections.abc import Sequence

from sdm.kernels.bvh.tree import LARGEST_LEAF
from sdm.kernels.dense.block_schedule import BUSY, CELL_BITS
from sdm.kernels.dense.chunk_pool import CHUNK
from sdm.kernels.dense.region_grid import BLOCK
from sdm.kernels.primitives.lanes import GPU_LANES

# Entries of the pool of lists: 64 MiB on a CPU, 128 MiB to 6 GiB on a GPU, of which they take at most a 16th.
CPU_POOL, SMALLEST_POOL, LARGEST_POOL = 1 << 24, 1 << 25, 3 << 29
POOL_SHARE = 16
# More than is expected, as cells whose lists find no room are searched voxel by voxel, which takes many times as long.
POOL_ROOM = 1.6
# So many times as much where a cell's box is long, or wider than its voxels: on a grid that is turned, or whose
# spacings differ by this factor or more.
UNEVEN_ROOM, UNEVEN = 3.0, 1.5
MOST_REGIONS = 1 << (CELL_BITS - 3)
# Groups of lanes of one map that are enough to keep a GPU busy, and up to how many share the list of a region, and of a
# cell, for that. Of a batch's maps they are as many as of one alone, so that the batch does not matter to a map's bits.
FULL, MOST_FOR_REGION, MOST_FOR_CELL = 1 << 14, 32, 8
# But maps of so few regions (64^3 voxels) mostly come in batches, where fewer, longer chains are faster.
FEW_REGIONS, FEW_FOR_REGION, FEW_FOR_CELL = 64, 16, 2
# Triangles of a cell's list, on average, up to which all lists are about as short.
SHORT = 64
# Triangles of the list of a cell of 16^3 voxels, on average, up to which one is better than eight for cells of 8^3:
# features that do not matter to a brick are worked out for it all the same.
SHORT_FOR_WIDE = {"cuda": 100, "cpu": 0}
# And of those on grids of so many voxels, or more, across, which have enough such cells to keep a GPU busy. Their
# bricks get lists of their own where cells are expected to have so many triangles or more.
FINE_FOR_LISTS = ((384, 2000), (256, 400))
SHORT_FOR_LISTS = 25
# Voxels along the longest axis of the smallest grid that may have them: bricks of 8^3 voxels of a coarser one around a
# mesh are too wide for float32, and are searched voxel by voxel (`region_grid.is_coarse`).
FINE_FOR_WIDE = 96
# And across the largest one whose cells have 4^3 voxels, as those of 8^3 would be too wide.
COARSE_FOR_CELLS = 40
# Triangles of a list, on average, that one group may make without holding up the others, and up to how many groups
# share the list of a region, and of a cell, for that.
LONG_SHARE = 256
MOST_OF_REGION, MOST_OF_CELL = 64, 16
# Triangles of a cell's list, on average, from which on lists are made of larger leaves: few of so many are dropped.
LONG_FOR_LEAVES = 400
# A cell's list that is longer is the work of several groups: than so many leaves or, where cells are so few that the
# last blocks would be waited for, about so many triangles. A CPU has fewer groups, and nothing to gain.
LONG_SPLIT, SHORT_SPLIT, FEW_CELLS = 512, 370, 1 << 13
NO_SPLITS = 1 << 30
# Leaves of a cell's list of which one group makes lists by brick, twice as many where there are more than so many
# cells; and splits of lists beyond the first that there is room for, on average, and in all.
LIST_SPLIT, CELLS_FOR_LONG = 128, 1 << 14
MORE_SPLITS, SPLITS_OF_ALL = 8, 1 << 18
# Voxels along the longest axis of a slab from which on its bricks are hardly ever too coarse for float32; and longer
# than any.
FINE, ALL_COARSE = 128, 1 << 30
# Up to which triangles of a cell's list, on average, up to how many groups of lanes work at one block: each works all
# features of its octants out anew, which costs more than it saves where these are many. It decides about no bits.
GROUPS_OF_BLOCK = ((160.0, 4), (600.0, 2))
# Layers of a slab: regions are of 16^3 or 32^3 voxels, and in whole ones a slab's are treated as in the whole map.
THINNEST_SLAB = 32
# Longer lists than this, on average, cost more than one search a voxel (see bench/decisions/0012-search-or-cells.md).
LONGEST_LIST = {"cuda": 50_000, "cpu": 16_000}


def expected_list(triangles: int, shape: Sequence[int], cell: int) -> float:
    """Triangles in the list of a cell of so many voxels along its edge, on average: a fit to some meshes.

    From the slab's cross-section alone, so that every slab of a grid is treated in the same way.
    """
    return 1.4 * triangles * cell**2 / max(shape[1:]) ** 2


def expected_entries(
    triangles: int, shape: Sequence[int], cell: int, of_region: int, of_cell: int, by_brick: bool = False
) -> float:
    """Entries of the pool to have for a region and its cells, on average: a fit to the same meshes, and room to spare.

    Of a region's leaves, and of its cells' leaves and features; half a chunk more for each chain of the first two,
    whose last one is not full, and of the features: of cells, or of their bricks.
    """
    length = expected_list(triangles, shape, cell)
    leaves, features = 0.8 * length + 25.0, 2.0 * length + 10.0
    half = CHUNK / 2
    of_features = features + half
    if by_brick:
        splits = 1.0 + leaves / LIST_SPLIT
        of_features = 8.0 * (2.0 * expected_list(triangles, shape, cell // 2) + 10.0 + splits * half)
    return POOL_ROOM * (4.5 * leaves + of_region * half + 8.0 * (leaves + of_cell * half + of_features))


def uneven_room(spacing: Sequence[float], turned: bool) -> float:
    """Factor by which cells of a grid like this take more entries of the pool."""
    shortest, longest = float(min(spacing)), float(max(spacing))
    return UNEVEN_ROOM if turned or longest >= UNEVEN * shortest else 1.0


def search_is_faster(triangles: int, shape: Sequence[int], gpu: bool) -> bool:
    """True if the plain path is expected to be the faster one; the same for any batch, so that its maps are too."""
    return expected_list(triangles, shape, int(BLOCK)) > LONGEST_LIST["cuda" if gpu else "cpu"]


def cell_for(triangles: int, shape: Sequence[int], gpu: bool) -> int:
    """Voxels along the edge of a cell: 8, or 16 where the lists of such cells are expected to be short.

    On a GPU 4 where larger ones would be too wide for float32: lists of their bricks are the work of few groups.
    """
    if gpu and max(shape[1:]) <= COARSE_FOR_CELLS:
        return 4
    short = SHORT_FOR_WIDE["cuda" if gpu else "cpu"]
    most = next((most for fine, most in FINE_FOR_LISTS if gpu and max(shape[1:]) >= fine), short)
    return 16 if expected_list(triangles, shape, 16) <= most and max(shape) >= FINE_FOR_WIDE else 8


def has_brick_lists(triangles: int, shape: Sequence[int], cell: int, gpu: bool) -> bool:
    """True if bricks of cells of so many voxels along an edge get lists of their own. It decides about no bits."""
    fine = gpu and cell > int(BLOCK) and max(shape[1:]) >= FINE_FOR_LISTS[-1][0]
    return fine and expected_list(triangles, shape, cell) >= SHORT_FOR_LISTS


def list_split_for(cells: int) -> int:
    """Leaves of a cell's list that one group of lanes of a GPU makes lists by brick of."""
    return 2 * LIST_SPLIT if cells > CELLS_FOR_LONG else LIST_SPLIT


def blocks_for(regions: int, chunks: int, split_length: int, by_brick: bool) -> int:
    """Blocks, one for each split of a list, that there is room for in the schedule of so many regions.

    Enough for all, as every split but the last of a list is full; but of lists by brick there are only as many splits
    as find room.
    """
    cells = 8 * regions
    return cells + (min(MORE_SPLITS * cells, SPLITS_OF_ALL) if by_brick else chunks * CHUNK // split_length)


def shares_of(triangles: int, shape: Sequence[int], cell: int) -> tuple[int, int]:
    """Groups of lanes that make each list of a region, and of a cell, on a GPU: so many that none is waited for.

    From the slab's cross-section alone, as `expected_list`. Powers of two: a level of the tree is shared out. A cell's
    are no more than its region's, whose chains they share out.
    """
    regions = max(1, -(-max(shape[1:]) // (2 * cell))) ** 3
    length = expected_list(triangles, shape, cell)
    few = regions <= FEW_REGIONS
    for_region, for_cell = (FEW_FOR_REGION, FEW_FOR_CELL) if few else (MOST_FOR_REGION, MOST_FOR_CELL)
    of_region = of_cell = 1
    while (of_region < for_region and 2 * of_region * regions <= FULL) or (
        of_region < MOST_OF_REGION and of_region * LONG_SHARE < 2.0 * length
    ):
        of_region *= 2
    # Lists of very different lengths need more groups than those that are all short.
    enough = FULL if length < SHORT else 8 * FULL
    while (of_cell < for_cell and 2 * of_cell * 8 * regions <= enough) or (
        of_cell < MOST_OF_CELL and of_cell * LONG_SHARE < length
    ):
        of_cell *= 2
    return of_region, min(of_cell, of_region)


def leaves_are_long(triangles: int, shape: Sequence[int]) -> bool:
    """True if lists are expected to be so long that some levels of the tree may be left out."""
    return expected_list(triangles, shape, int(BLOCK)) >= LONG_FOR_LEAVES


def levels_left_out(triangles: int, depth: int, shape: Sequence[int]) -> int:
    """Levels of a tree with 2^depth leaves that lists do without (see `tree.coarser`).

    From the slab's cross-section alone, as `expected_list`.
    """
    return levels_of_large_leaves(triangles, depth) if leaves_are_long(triangles, shape) else 0


def levels_of_large_leaves(triangles: int, depth: int) -> int:
    """The same where lists are long."""
    levels = 0
    while levels < depth and triangles <= LARGEST_LEAF << (depth - levels - 1):
        levels += 1
    return levels


def split_length_for(triangles: int, depth: int, cells: int) -> int:
    """Leaves of a cell's list that one group of lanes of a GPU takes, of a tree with 2^depth leaves: a power of two."""
    if cells > FEW_CELLS:
        return LONG_SPLIT
    return max(GPU_LANES, 1 << max(0, round(math.log2(SHORT_SPLIT / triangles) + depth)))


def groups_of_block(blocks: int, length: float) -> int:
    """Most groups of lanes of a GPU for each of so many blocks, of cells whose lists have `length` triangles."""
    groups, most = 1, next((most for limit, most in GROUPS_OF_BLOCK if length <= limit), 1)
    while groups < most and 2 * groups * blocks <= BUSY:
        groups *= 2
    return groups


def is_measured_together(regions: int, cell: int) -> bool:
    """True if the blocks of so many regions are so few that all groups of a GPU's thread block measure one at a time.

    It decides about no bits.
    """
    blocks = 8 * regions * (8 if cell > int(BLOCK) else 1)
    return 2 * blocks <= BUSY


def shares_and_parts(triangles: int, shape: Sequence[int], regions: int, cell: int) -> tuple[int, int]:
    """Groups of lanes of a GPU that make the list of features of a block, and that measure one."""
    length = expected_list(triangles, shape, int(BLOCK))
    # A region has eight cells, which are measured as they are, or by bricks.
    lists = 8 * regions
    parts = groups_of_block(8 * lists if cell > int(BLOCK) else lists, length)
    # Parts are octants, of which a cell of 4^3 voxels is one.
    return groups_of_block(lists, length), parts if cell >= int(BLOCK) else 1


def without_idle_splits(split_length: int, depth: int) -> int:
    """The same, or `NO_SPLITS` where a tree with 2^depth leaves has no longer lists: stage 7 is two launches."""
    return NO_SPLITS if 1 << depth <= split_length else split_length


def largest_pool(memory: int) -> int:
    """Entries of the largest pool of lists on a GPU with so many bytes of memory."""
    return min(LARGEST_POOL, max(SMALLEST_POOL, memory // POOL_SHARE // 4))


def pool_for(expected: float, regions: int, memory: int | None) -> int:
    """Entries of the pool of lists for so many regions, of which each takes so many; a CPU has no `memory` here."""
    if memory is None:
        return CPU_POOL
    return min(max(SMALLEST_POOL, math.ceil(expected * regions)), largest_pool(memory))


def passes_for(expected: float, regions: int, room: int, most: int = MOST_REGIONS) -> int:
    """Number of passes over so many regions, at most `most` each, that have room. Each waits for its longest lists."""
    fit = regions if expected * regions <= room else max(16, int(room / expected))
    return -(-regions // min(regions, most, fit))
