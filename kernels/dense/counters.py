"""Counters of a pass: one array of whole numbers that all groups of lanes add to, zero at the start.

The first ones hand out work: each group fetches the number of its next item. The others count what is made: chunks of
the pool, and blocks by their kind and the length of their lists. So a pass whose counters of work are beyond all items
makes nothing: see `stop_if_wrong`.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.topology.edge_pairing import OUT_OF_RANGE, UNMATCHED

wp.set_module_options({"enable_backward": False})

NEXT_WITNESS, NEXT_REGION, NEXT_CELL, NEXT_CELL_TO_SCHEDULE, NEXT_LIST, NEXT_BRICK_LISTS, NEXT_BLOCK = range(7)
NEXT_CHUNK, COARSE, SPLIT_CELLS, MORE_SPLITS, WHOLE = range(7, 12)
# Whole blocks are counted by the length of their lists: of 2^i leaves and more, up to the longest of splits.
LENGTHS = 10
COUNTS = WHOLE + LENGTHS
# More than there are items of any kind, by far less than what counting on from there could overflow.
BEYOND = 1 << 30


@wp.kernel
def _stop_if_wrong(begin: int, found: wp.array(dtype=wp.int32), room: int, counters: wp.array(dtype=wp.int32)):
    counter = begin + wp.tid()
    if found[UNMATCHED] > room or found[OUT_OF_RANGE] != 0:
        counters[counter] = BEYOND


def stop_if_wrong(found: wp.array, room: int, counters: wp.array) -> None:
    """Let a pass make nothing from regions on, as its result will be thrown away: its guess about a mesh was wrong.

    Args:
        found: (2) int32, the flags of `sdm.kernels.topology.edge_pairing.pair_edges`.
        room: Most unmatched edges for which the guess is right.
        counters: (COUNTS) int32, of a pass that has begun, before its regions are listed.
    """
    # Witnesses are found meanwhile, and what comes after cells are scheduled has nothing to do then.
    launch(_stop_if_wrong, NEXT_LIST - NEXT_REGION, [found, room, counters[NEXT_REGION:]], counters.device)
