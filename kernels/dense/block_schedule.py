"""Schedule of blocks: the cells of a pass, each as one block or as several with a split of its candidate list each.

Whole cells are kept by the length of their lists, so that those with long ones come first; coarse cells, which are
measured brick by brick, apart from them.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.counters import COARSE, LENGTHS, MORE_SPLITS, SPLIT_CELLS, WHOLE
from sdm.kernels.primitives.atomics import fetch_add

wp.set_module_options({"enable_backward": False})

# A cell's number, which of its splits, how many there are less one, in one integer.
CELL_BITS, SPLIT_BITS = 18, 6
_MOST_SPLITS = 1 << SPLIT_BITS
# Groups of lanes that are enough to make lists of features, or to measure blocks; and to make lists, once the number of
# blocks is known.
BUSY, LISTING = 1 << 11, 1 << 12


@wp.func
def cell_of(code: int):
    return code & ((1 << CELL_BITS) - 1)


@wp.func
def split_of(code: int):
    return (code >> CELL_BITS) & (_MOST_SPLITS - 1)


@wp.func
def splits_of(code: int):
    return 1 + (code >> (CELL_BITS + SPLIT_BITS))


@wp.func
def any_groups(groups: int):
    """Groups of lanes that share a block, as a kernel is told."""
    return groups


@wp.func
def one_group(groups: int):
    """The one group of most blocks: so a compiler leaves out what several ask."""
    return 1


BY_GROUPS = any_groups, one_group


@wp.func
def groups_at_work(most: int, blocks: int, enough: int):
    """Groups of lanes that share each of so many blocks: a power of two up to `most`, in all no more than `enough`."""
    groups = int(most)
    while groups > 1 and groups * blocks > enough:
        groups = groups / 2
    return groups


@wp.struct
class BlockSchedule:
    """Cells and which split of their lists, in codes: see `cell_of`, `split_of` and `splits_of`."""

    whole: wp.array(dtype=wp.int32)  # (LENGTHS * room) of cells that are measured whole, by the length of their lists
    room: wp.int32  # for so many blocks of each length
    coarse: wp.array(dtype=wp.int32)  # (room) of cells that are measured brick by brick
    split_cells: wp.array(dtype=wp.int32)  # (8 * regions) the cells whose lists are cut into splits
    lacking: wp.array(dtype=wp.int32)  # (8 * regions) of those, 1 where the pool ran out for one of the splits
    counters: wp.array(dtype=wp.int32)  # (COUNTS) of the pass, see `counters`
    parts: wp.int32  # groups of lanes that measure each block, some of its octants each: 1, 2, 4 or 8; with winners
    together: wp.int32  # without: 1 if all groups of a thread block measure each block
    # Where bricks have lists of their own: splits of all cells' lists beyond the first of each, at most; else -1.
    # Leaves of such a split, and how many of them one group measures.
    more: wp.int32
    list_split: wp.int32
    at_once: wp.int32


@wp.func
def whole_blocks(schedule: BlockSchedule):
    """Number of blocks that are whole cells, or splits of their lists."""
    total = int(0)
    for length in range(LENGTHS):
        total = total + schedule.counters[WHOLE + length]
    return total


@wp.func_native(
    snippet=f"""
    int length = {LENGTHS - 1};
    // Not written out several times: code that does not fit into a GPU's cache has to be waited for.
    #pragma unroll 1
    for (int here; item >= (here = counters.data[{WHOLE} + length]); --length) item -= here;
    return length * room + item;
"""
)
def _place_of_whole(counters: wp.array(dtype=wp.int32), room: int, item: int) -> int: ...


@wp.func
def whole_block(schedule: BlockSchedule, item: int):
    """The code of one of them: those with the longest lists first."""
    return schedule.whole[_place_of_whole(schedule.counters, schedule.room, item)]


@wp.func
def length_class(length: int):
    """Length class of a list: the power of two that is in its length."""
    power = int(0)
    while power < LENGTHS - 1 and (length >> (power + 1)) > 0:
        power = power + 1
    return power


@wp.func
def share_out(schedule: BlockSchedule, whole: bool, number: int, length: int, split_length: int):
    """Note a cell, `whole` or brick by brick, once for each split of its list.

    Where bricks have lists of their own, splits of `list_split` leaves are what a group makes lists of; `at_once` of
    them are measured by one. Then there are splits as far as there is room.
    """
    by_brick = schedule.more >= 0
    each = wp.where(by_brick and whole, schedule.list_split, split_length)
    splits = wp.clamp((length + each - 1) / each, 1, _MOST_SPLITS)
    if by_brick and splits > 1:
        if fetch_add(schedule.counters, MORE_SPLITS, splits - 1) + splits - 1 > schedule.more:
            splits = 1
    if splits > wp.where(by_brick and whole, schedule.at_once, 1):
        schedule.split_cells[fetch_add(schedule.counters, SPLIT_CELLS, 1)] = number
        schedule.lacking[number] = 0
    code = number | ((splits - 1) << (CELL_BITS + SPLIT_BITS))
    if whole:
        kind = length_class(wp.min(length, split_length))
        first = kind * schedule.room + fetch_add(schedule.counters, WHOLE + kind, splits)
        for i in range(splits):
            schedule.whole[first + i] = code | (i << CELL_BITS)
    else:
        first = fetch_add(schedule.counters, COARSE, splits)
        for i in range(splits):
            schedule.coarse[first + i] = code | (i << CELL_BITS)
