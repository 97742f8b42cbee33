"""Blocks as bits of the whole grid: set in any order, and listed in two, without a sort.

There are two sets of bits over the same blocks: one with a row for each x and y, along z, and one with a row for each y
and z, along x. Lists of a band's blocks follow from them by counting rows: by x, y, z, as a band has them, and by y, z,
x, as crossings are summed up. A bit for 512 voxels is a fortieth of what even a thin band's blocks take.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.geometry.block_table import BlockTable, place_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.bits import first_of, members_of, set_bits, without_first

wp.set_module_options({"enable_backward": False})

# What is counted: blocks, and regions that have some; blocks that are kept, and runs between those that are inside;
# voxels with an unclear winding number; crossings in no block; chunks of candidate lists.
BLOCKS, REGIONS, KEPT, RUNS, AMBIGUOUS, LOST, CHUNKS, COUNTS = 0, 1, 2, 3, 4, 5, 6, 7
# Bits of a word.
WORD = 32


@wp.struct
class BlockBits:
    """The bits of both sets, those along z before those along x, and what their rows are."""

    words: wp.array(dtype=wp.int32)
    along: wp.vec3i  # blocks along each axis
    deep: wp.int32  # words of a row along z
    wide: wp.int32  # words of a row along x
    rows: wp.int32  # rows along z
    lines: wp.int32  # rows along x


def words_of(along: tuple[int, int, int]) -> tuple[int, int]:
    """Words of all bits of so many blocks, and rows of both kinds."""
    x, y, z = along
    return x * y * -(-z // WORD) + y * z * -(-x // WORD), x * y + y * z


def block_bits(along: tuple[int, int, int]) -> Any:
    """The bits of so many blocks along each axis, of which the words are still to be set."""
    made: Any = BlockBits()
    x, y, z = along
    made.along, made.deep, made.wide = wp.vec3i(x, y, z), -(-z // WORD), -(-x // WORD)
    made.rows, made.lines = x * y, y * z
    return made


@wp.func
def mark_block(bits: BlockBits, at: wp.vec3i):
    """Set the bits of a block, while others do the same."""
    row = at[0] * bits.along[1] + at[1]
    line = at[1] * bits.along[2] + at[2]
    set_bits(bits.words, row * bits.deep + (at[2] >> 5), 1 << (at[2] & 31))
    set_bits(bits.words, bits.rows * bits.deep + line * bits.wide + (at[0] >> 5), 1 << (at[0] & 31))


@wp.kernel
def _count_rows(begin: int, bits: BlockBits, counts: wp.array(dtype=wp.int32)):
    row = begin + wp.tid()
    size = bits.deep
    first = row * bits.deep
    if row >= bits.rows:
        size = bits.wide
        first = bits.rows * bits.deep + (row - bits.rows) * bits.wide
    total = int(0)
    for word in range(size):
        total = total + members_of(bits.words[first + word])
    counts[row] = total


@wp.kernel
def _write_blocks(
    begin: int,
    bits: BlockBits,
    ends: wp.array(dtype=wp.int32),
    room: int,
    blocks: wp.array(dtype=wp.vec3i),
    rows: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
):
    row = begin + wp.tid()
    place = int(0)
    if row > 0:
        place = ends[row - 1]
    rows[row] = wp.min(place, room)
    if row + 1 == bits.rows:
        counts[BLOCKS] = ends[row]
        rows[row + 1] = wp.min(ends[row], room)
    x = row / bits.along[1]
    y = row - x * bits.along[1]
    if place < ends[row]:
        for word in range(bits.deep):
            left = bits.words[row * bits.deep + word]
            while left != 0:
                if place < room:
                    blocks[place] = wp.vec3i(x, y, WORD * word + first_of(left))
                place = place + 1
                left = without_first(left)


@wp.kernel
def _write_order(
    begin: int,
    bits: BlockBits,
    ends: wp.array(dtype=wp.int32),
    table: BlockTable,
    order: wp.array(dtype=wp.int32),
):
    line = begin + wp.tid()
    before = ends[bits.rows - 1]
    place = int(0)
    if line > 0:
        place = ends[bits.rows + line - 1] - before
    end = ends[bits.rows + line] - before
    y = line / bits.along[2]
    z = line - y * bits.along[2]
    if place < end:
        for word in range(bits.wide):
            left = bits.words[bits.rows * bits.deep + line * bits.wide + word]
            while left != 0:
                if place < order.shape[0]:
                    # Of blocks without room nothing is asked.
                    order[place] = wp.max(place_of(table, wp.vec3i(WORD * word + first_of(left), y, z)), 0)
                place = place + 1
                left = without_first(left)


@wp.kernel
def _list_regions(
    begin: int,
    bits: BlockBits,
    edge_bits: int,
    along: wp.vec3i,
    regions: wp.array(dtype=wp.vec4i),
    counts: wp.array(dtype=wp.int32),
):
    """A word of four or of sixteen rows: the regions of 2^3 cells, of edge^3 blocks, with some."""
    thread = begin + wp.tid()
    word = thread % bits.deep
    y = (thread / bits.deep) % along[1]
    x = thread / bits.deep / along[1]
    edge = 1 << edge_bits
    some = int(0)
    for i in range(edge):
        for j in range(edge):
            if edge * x + i < bits.along[0] and edge * y + j < bits.along[1]:
                row = (edge * x + i) * bits.along[1] + edge * y + j
                some = some | bits.words[row * bits.deep + word]
    if some == 0:
        return
    half = edge >> 1
    low = (1 << half) - 1
    for k in range(WORD >> edge_bits):
        shift = k << edge_bits
        if ((some >> shift) & ((low << half) | low)) != 0:
            cells = int(0)
            for i in range(edge):
                for j in range(edge):
                    if edge * x + i < bits.along[0] and edge * y + j < bits.along[1]:
                        row = (edge * x + i) * bits.along[1] + edge * y + j
                        mine = bits.words[row * bits.deep + word] >> shift
                        first = 4 * (i / half) + 2 * (j / half)
                        if (mine & low) != 0:
                            cells = cells | (1 << first)
                        if ((mine >> half) & low) != 0:
                            cells = cells | (2 << first)
            place = fetch_add(counts, REGIONS, 1)
            if place < regions.shape[0]:
                regions[place] = wp.vec4i(x, y, (WORD >> edge_bits) * word + k, cells)


def list_bits(
    bits: Any,
    ends: wp.array,
    table: Any,
    order: wp.array,
    cell_bits: int | None,
    regions: wp.array,
    counts: wp.array,
) -> None:
    """List the blocks whose bits are set, and the regions of 2^3 cells that have some.

    What has no room is counted alone.

    Args:
        bits: See `BlockBits`.
        ends: (2 * (rows + lines),) int32, workspace.
        table: A `BlockTable` of all rows, whose arrays are filled.
        order: Filled with the blocks' places, sorted by y, then z, then x.
        cell_bits: Cells have 2^this blocks along an edge, 0 or 1; None for no regions.
        regions: vec4i, filled in any order: places, and a bit for each cell that has a block.
        counts: (COUNTS,) int32, zeros: `BLOCKS` and `REGIONS` are counted.
    """
    device, rows, lines = order.device, int(bits.rows), int(bits.lines)
    numbers, summed = ends[: rows + lines], ends[rows + lines :]
    launch(_count_rows, rows + lines, [bits, numbers], device)
    wp.utils.array_scan(numbers, summed, inclusive=True)
    launch(_write_blocks, rows, [bits, summed, order.size, table.blocks, table.rows, counts], device)
    launch(_write_order, lines, [bits, summed, table, order], device)
    if cell_bits is not None:
        edge = 2 << cell_bits
        along = wp.vec3i(-(-bits.along[0] // edge), -(-bits.along[1] // edge), 0)
        inputs = [bits, cell_bits + 1, along, regions, counts]
        launch(_list_regions, along[0] * along[1] * int(bits.deep), inputs, device)
