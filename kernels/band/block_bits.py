"""Blocks as bits of the whole grid: set in any order, and listed in two, without a sort.

There are two sets of bits over the same blocks: one with a row for each x and y, along z, and one with a row for each y
and z, along x. Lists of a band's blocks follow from them by counting rows: by x, y, z, as a band has them, and by y, z,
x, as crossings are summed up. A bit for 512 voxels is a fortieth of what even a thin band's blocks take.
"""

from __future__ import annotations

from typing import Any

import warp as wp

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


@wp.func
def is_marked(bits: BlockBits, at: wp.vec3i):
    """True if the bits of a block are set, or about to be by another."""
    word = bits.words[(at[0] * bits.along[1] + at[1]) * bits.deep + (at[2] >> 5)]
    return (word & (1 << (at[2] & 31))) != 0


@wp.func
def marked_before(bits: BlockBits, first: int, word: int):
    """Number of bits that are set in so many words from a first one on."""
    total = int(0)
    for before in range(word):
        total = total + members_of(bits.words[first + before])
    return total


@wp.kernel
def _count_rows(begin: int, bits: BlockBits, counts: wp.array(dtype=wp.int32)):
    row = begin + wp.tid()
    size = bits.deep
    first = row * bits.deep
    if row >= bits.rows:
        size = bits.wide
        first = bits.rows * bits.deep + (row - bits.rows) * bits.wide
    counts[row] = marked_before(bits, first, size)


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
    """A word of a row along z: its blocks; and of the first word where the row begins."""
    number = begin + wp.tid()
    row = number / bits.deep
    word = number - row * bits.deep
    place = int(0)
    if row > 0:
        place = ends[row - 1]
    if word == 0:
        rows[row] = wp.min(place, room)
        if row + 1 == bits.rows:
            counts[BLOCKS] = ends[row]
            rows[row + 1] = wp.min(ends[row], room)
    left = bits.words[number]
    if left == 0:
        return
    x = row / bits.along[1]
    y = row - x * bits.along[1]
    place = place + marked_before(bits, row * bits.deep, word)
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
    order: wp.array(dtype=wp.int32),
):
    """A word of a row along x: the places of its blocks, which are counted in their rows along z."""
    number = begin + wp.tid()
    line = number / bits.wide
    word = number - line * bits.wide
    first = bits.rows * bits.deep
    left = bits.words[first + number]
    if left == 0:
        return
    place = marked_before(bits, first + line * bits.wide, word)
    if line > 0:
        place = place + ends[bits.rows + line - 1] - ends[bits.rows - 1]
    y = line / bits.along[2]
    z = line - y * bits.along[2]
    while left != 0:
        if place < order.shape[0]:
            row = (WORD * word + first_of(left)) * bits.along[1] + y
            mine = marked_before(bits, row * bits.deep, z >> 5)
            mine = mine + members_of(bits.words[row * bits.deep + (z >> 5)] & ((1 << (z & 31)) - 1))
            if row > 0:
                mine = mine + ends[row - 1]
            # Of blocks without room nothing is asked.
            order[place] = wp.where(mine < order.shape[0], mine, 0)
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
    """A region of 2^3 cells, of edge^3 blocks: listed if it has some."""
    thread = begin + wp.tid()
    z = thread % along[2]
    y = (thread / along[2]) % along[1]
    x = thread / along[2] / along[1]
    edge = 1 << edge_bits
    half = edge >> 1
    low = (1 << half) - 1
    word = (z << edge_bits) >> 5
    shift = (z << edge_bits) & (WORD - 1)
    cells = int(0)
    for i in range(edge):
        for j in range(edge):
            if edge * x + i < bits.along[0] and edge * y + j < bits.along[1]:
                row = (edge * x + i) * bits.along[1] + edge * y + j
                mine = bits.words[row * bits.deep + word] >> shift
                if edge == 1:
                    # All cells are in one block.
                    cells = wp.where((mine & 1) != 0, 255, 0)
                else:
                    first = 4 * (i / half) + 2 * (j / half)
                    if (mine & low) != 0:
                        cells = cells | (1 << first)
                    if ((mine >> half) & low) != 0:
                        cells = cells | (2 << first)
    if cells != 0:
        place = fetch_add(counts, REGIONS, 1)
        if place < regions.shape[0]:
            regions[place] = wp.vec4i(x, y, z, cells)


def list_bits(
    bits: Any,
    ends: wp.array,
    table: Any,
    order: wp.array,
    region_bits: int | None,
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
        region_bits: Regions have 2^this blocks along an edge, 0 to 2; None for none.
        regions: vec4i, filled in any order: places, and a bit for each cell that has a block.
        counts: (COUNTS,) int32, zeros: `BLOCKS` and `REGIONS` are counted.
    """
    device, rows, lines = order.device, int(bits.rows), int(bits.lines)
    numbers, summed = ends[: rows + lines], ends[rows + lines :]
    launch(_count_rows, rows + lines, [bits, numbers], device)
    wp.utils.array_scan(numbers, summed, inclusive=True)
    inputs = [bits, summed, order.size, table.blocks, table.rows, counts]
    launch(_write_blocks, rows * int(bits.deep), inputs, device)
    launch(_write_order, lines * int(bits.wide), [bits, summed, order], device)
    if region_bits is not None:
        edge = 1 << region_bits
        x, y, z = (-(-n // edge) for n in bits.along)
        inputs = [bits, region_bits, wp.vec3i(x, y, z), regions, counts]
        launch(_list_regions, x * y * z, inputs, device)
