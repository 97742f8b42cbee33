"""Counters of a pass: one array of whole numbers that all groups of lanes add to, zero at the start.

The first ones hand out work: each group fetches the number of its next item. The others count what is made: chunks of
the pool, and blocks by their kind and the length of their lists.
"""

from __future__ import annotations

NEXT_WITNESS, NEXT_REGION, NEXT_CELL, NEXT_CELL_TO_SCHEDULE, NEXT_LIST, NEXT_BRICK_LISTS, NEXT_BLOCK = range(7)
NEXT_CHUNK, COARSE, SPLIT_CELLS, MORE_SPLITS, WHOLE = range(7, 12)
# Whole blocks are counted by the length of their lists: of 2^i leaves and more, up to the longest of splits.
LENGTHS = 10
COUNTS = WHOLE + LENGTHS
