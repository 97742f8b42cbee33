"""Regions, cells and bricks of voxels, and lists of what may be nearest to each.

A cell has 8^3 voxels, a region 2^3 cells, and a brick is an eighth of a cell. Where the lists of larger cells are short
as well, cells have 16^3 voxels, and their bricks, which then have 8^3, are measured from one list.

Lists have no length known before, so they are chains of chunks from a pool. Whoever finds the pool empty is marked, and
its voxels are searched one by one later: slower, never wrong. Where boxes are few, each list is made by several groups
of lanes, of one share of the tree each: a chain for each.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import DIAGONAL, FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_voxels, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, unravel
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import ballot, members, rank

wp.set_module_options({"enable_backward": False})

# Voxels along the edge of the largest block that is measured at a time.
BLOCK = 8
# Half-width of a box of voxels, scaled, beyond which it is not measured as a whole.
COARSEST = 0.125
CHUNK = 64
ROOM = 63  # entries of a chunk; the last place names the next chunk
# Places of the shared counts.
NEXT_WITNESS, NEXT_REGION, NEXT_CELL, NEXT_CELL_TO_SCHEDULE, NEXT_LIST, NEXT_BLOCK = range(6)
NEXT_CHUNK, COARSE, SLICED, WHOLE = range(6, 10)
# Blocks are counted by the length of their lists: of 2^i leaves and more, up to the longest of slices.
LENGTHS = 10
COUNTS = WHOLE + LENGTHS


@wp.struct
class Lists:
    """The regions of one pass, their eight cells each, and the lists of both."""

    regions: wp.vec3i  # regions along each axis of the slab
    first: wp.int32  # first region of this pass, counting through the meshes
    step: wp.int32  # from it to the next
    cell: wp.int32  # voxels along the edge of a cell: 8 or 16
    count: wp.int32  # regions of this pass
    region_shares: wp.int32  # chains of each region's list
    shares: wp.int32  # and of each cell's: as many, or a power of two less
    # Of each chain its first chunk, or -1 where the pool ran out, and its number of entries.
    region_heads: wp.array(dtype=wp.int32)  # (count * region_shares) leaves of the tree
    region_lengths: wp.array(dtype=wp.int32)
    heads: wp.array(dtype=wp.int32)  # (8 * count * shares) leaves as well
    lengths: wp.array(dtype=wp.int32)
    # Surface points seen from centres: the vector from there, and its square.
    witnesses: wp.array(dtype=wp.float32)  # (73 * count * 4) of regions, then cells, then bricks
    # Where cells are and, of cells of more than a block, their bricks, see `cell_cache`.
    places: wp.array(dtype=wp.float32)  # (72 or 8 * count * PLACE_FLOATS)
    nearest: wp.array(dtype=wp.float32)  # (8 * count * shares * 4) the nearest of each share's to each cell
    # Cells and which slice of their lists, see `stage4_blocks`: those that are measured whole, and those brick by
    # brick.
    whole: wp.array(dtype=wp.int32)  # (LENGTHS * slices)
    slices: wp.int32  # room for so many blocks of each length
    coarse: wp.array(dtype=wp.int32)
    sliced: wp.array(dtype=wp.int32)  # (8 * count) the cells whose lists are cut into several slices
    lacking: wp.array(dtype=wp.int32)  # (8 * count) of those, 1 where the pool ran out for one of the slices
    feature_heads: wp.array(dtype=wp.int32)  # of each block the features that matter to it
    feature_lengths: wp.array(dtype=wp.int32)
    pool: wp.array(dtype=wp.int32)  # (chunks * CHUNK)
    chunks: wp.int32
    given: wp.int32  # the first chunks: one for each chain of a region, then of a cell
    counts: wp.array(dtype=wp.int32)  # (COUNTS) shared counters, zero at the start


@wp.func
def make_cell(tree: Tree, slab: Slab, mesh: int, start: wp.vec3i, size: int):
    """The same for what is compared with a mesh's surface points."""
    frame = mesh * FRAME_SIZE
    cell = box_of_voxels(slab, start, size, float(tree.frame[frame + SCALE]))
    cell.diagonal = float(tree.frame[frame + DIAGONAL])
    return cell


@wp.func
def is_coarse(cell: VoxelBox):
    """True if a box is so wide that float32 rounds a place in it too much."""
    return wp.max(cell.half) > COARSEST


@wp.func
def region_start(lists: Lists, item: int):
    """The mesh, and the first voxel, of a region."""
    mesh, at = unravel(lists.first + item * lists.step, lists.regions)
    return mesh, 2 * lists.cell * at


@wp.func
def cell_start(lists: Lists, item: int):
    """The mesh, and the first voxel, of a cell."""
    mesh, start = region_start(lists, item / 8)
    return mesh, start + lists.cell * octant_at(item)


@wp.func
def brick_start(lists: Lists, start: wp.vec3i, item: int):
    """The first voxel of brick `item` % 8 of a cell that starts there."""
    return start + (lists.cell / 2) * octant_at(item)


@wp.struct
class Chain:
    """A list that grows."""

    chunk: wp.int32  # its last chunk; `lists.chunks` or more if the pool ran out
    fill: wp.int32  # entries of that chunk
    length: wp.int32  # entries of all


@wp.func
def append(lists: Lists, chain: Chain, keep: bool, entry: int, lane: int):
    """Add the lanes' entries to a chain, which is returned."""
    if chain.chunk >= lists.chunks:
        return chain
    mask = ballot(keep)
    added = members(mask)
    at = chain.fill + rank(mask, lane)
    fresh = chain.chunk
    if chain.fill + added > ROOM:
        fresh = lists.given + fetch_add_once(lists.counts, NEXT_CHUNK, 1, lane)
        if fresh < lists.chunks and lane == 0:
            lists.pool[chain.chunk * CHUNK + ROOM] = fresh
    if keep:
        if at < ROOM:
            lists.pool[chain.chunk * CHUNK + at] = entry
        elif fresh < lists.chunks:
            lists.pool[fresh * CHUNK + at - ROOM] = entry
    chain.fill = chain.fill + added
    if chain.fill > ROOM:
        chain.fill = chain.fill - ROOM
    chain.chunk = fresh
    chain.length = chain.length + added
    return chain


@wp.func_native(
    snippet="""
    int total = 0;
    // Not written out several times: code that does not fit into a GPU's cache has to be waited for.
    #pragma unroll 1
    for (int i = first; i < first + count; ++i) {
        if (heads.data[i] < 0) return -1;
        total += lengths.data[i];
    }
    return total;
"""
)
def list_length(heads: wp.array(dtype=wp.int32), lengths: wp.array(dtype=wp.int32), first: int, count: int) -> int:
    """Entries of `count` chains from `first`, or -1 if the pool ran out for one."""
    ...


@wp.struct
class Reader:
    """A place in a list: `left` entries of chain `chain` are not read, of those the first at `at` of `chunk`."""

    chain: wp.int32
    end: wp.int32  # one past the list's last chain
    chunk: wp.int32
    left: wp.int32
    at: wp.int32


@wp.func
def next_chain(heads: wp.array(dtype=wp.int32), lengths: wp.array(dtype=wp.int32), reader: Reader):
    """Go on to the next chain that has entries."""
    reader.at = 0
    while reader.left == 0 and reader.chain + 1 < reader.end:
        reader.chain = reader.chain + 1
        reader.chunk = heads[reader.chain]
        reader.left = lengths[reader.chain]
    return reader


@wp.func
def start_reading(heads: wp.array(dtype=wp.int32), lengths: wp.array(dtype=wp.int32), first: int, count: int):
    """The first place of the list of `count` chains from `first`; none may lack room. `left` is 0 at its end."""
    reader = Reader()
    reader.chain = first - 1
    reader.end = first + count
    return next_chain(heads, lengths, reader)


@wp.func
def read_entry(lists: Lists, reader: Reader, lane: int):
    """A lane's entry, or -1 if there is none for it."""
    if reader.at + lane < wp.min(reader.left, ROOM):
        return lists.pool[reader.chunk * CHUNK + reader.at + lane]
    return -1


@wp.func
def read_on(
    lists: Lists, heads: wp.array(dtype=wp.int32), lengths: wp.array(dtype=wp.int32), reader: Reader, lanes: int
):
    """The place after the lanes' entries."""
    reader.at = reader.at + lanes
    if reader.at >= wp.min(reader.left, ROOM):
        reader.left = reader.left - wp.min(reader.left, ROOM)
        reader.at = 0
        if reader.left > 0:
            reader.chunk = lists.pool[reader.chunk * CHUNK + ROOM]
        else:
            reader = next_chain(heads, lengths, reader)
    return reader
