"""Workspace of a dense query: the arrays that its stages write and read, of sizes that follow from the plan."""
# pyright: basic, reportGeneralTypeIssues=false, reportOptionalMemberAccess=false

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import warp as wp

from sdm.kernels.dense.block_schedule import BlockSchedule
from sdm.kernels.dense.cell_cache import BOX_FLOATS, CellCache
from sdm.kernels.dense.chunk_pool import CHUNK, CandidateLists, ChunkPool
from sdm.kernels.dense.counters import COUNTS, LENGTHS
from sdm.kernels.dense.plan import Plan
from sdm.kernels.dense.region_grid import BLOCK, RegionGrid
from sdm.kernels.launch import set_array, set_number
from sdm.kernels.launches.arrays import array_at, size_of

# Counters, and the number of what was missed.
ZEROS = COUNTS + 1
# Arrays begin at multiples of this many bytes.
ALIGNMENT = 256


@dataclass(slots=True)
class Workspace:
    """Structs for the kernels, each written by some stages and read by those after.

    Args:
        grid: The regions of a pass, set by the host before each.
        zeros: (ZEROS) int32, the counters and what was missed: zeroed before the first pass.
        counters: (COUNTS) int32, zeroed before each pass; the pool and the schedule have them too.
        missed: (1) int32 voxels that found no room in any pass.
        cache: Boxes and witnesses: stages 1, 4 and 5 write, all read.
        pool: Entries of all lists: stages 2, 3 and 5 write.
        regions: Leaves for each region, written by stage 2 for stage 3.
        cells: Leaves for each cell, written by stage 3 for stages 4 and 5.
        share_witnesses: Witness of each share of a cell's list, written by stage 3 for stage 4.
        schedule: Blocks and their splits, written by stage 4 for stages 5 to 7.
        blocks: Features for each block, written by stage 5 for stage 6.
    """

    grid: Any
    zeros: wp.array
    counters: wp.array
    missed: wp.array
    cache: Any
    pool: Any
    regions: Any
    cells: Any
    share_witnesses: wp.array
    schedule: Any
    blocks: Any

    def begin_pass(self, plan: Plan, first: int, is_zero: bool = False) -> None:
        """Set the pass that begins with region `first`, and zero the counters if they are not."""
        # Each pass takes regions from everywhere, so that no pass gets all the long lists.
        count = -(-(plan.total - first) // plan.passes)
        grid, pool = self.grid, self.pool
        set_number(grid, "first", first)
        set_number(grid, "count", count)
        set_number(pool, "reserved", count * (plan.region_shares + 8 * plan.cell_shares))
        if not is_zero:
            (self.counters if first else self.zeros).zero_()


def make_workspace(plan: Plan, empty: Callable[[int, Any], wp.array], zeros: wp.array | None = None) -> Workspace:
    """The workspace of a query, in one piece of memory; `empty(length, dtype)` allocates.

    `zeros`: (ZEROS) int32 for its counters, if they lie elsewhere.
    """
    # Counted by eights: bytes may be more than an array counts.
    block: Any = empty(size_for(plan) // 8, wp.int64)
    if zeros is not None:
        return _workspace(plan, _Places(block.ptr, block.device.alias), zeros)
    return _workspace_at(plan, block.ptr, block.device.alias)


@lru_cache(maxsize=64)
def size_for(plan: Plan) -> int:
    """Bytes of a workspace."""
    places = _Places(0, "cpu")
    _workspace(plan, places)
    return places.end


# Torch gives the same few addresses again and again, and who has memory at one is alone with it.
@lru_cache(maxsize=64)
def _workspace_at(plan: Plan, address: int, device: str) -> Workspace:
    return _workspace(plan, _Places(address, device))


class _Places:
    """Arrays one after the other, from an address on."""

    def __init__(self, address: int, device: str) -> None:
        self.end, self._device = address, device

    def __call__(self, length: int, dtype: Any) -> wp.array:
        array = array_at(self.end, (length,), dtype, self._device)
        size = length * size_of(dtype)
        self.end += size + -size % ALIGNMENT
        return array


def _workspace(plan: Plan, empty: Callable[[int, Any], wp.array], zeros: wp.array | None = None) -> Workspace:
    most, room = plan.most, plan.blocks
    grid = RegionGrid()
    grid.regions = wp.vec3i(*plan.regions)
    grid.step, grid.cell, grid.by_brick = plan.passes, plan.cell, int(plan.by_brick)
    regions = _lists(most, plan.region_shares, empty)
    cells = _lists(8 * most, plan.cell_shares, empty)
    cache = CellCache()
    set_array(cache, "witnesses", empty((1 + 8 + 64) * most * 4, wp.float32))
    # Bricks of smaller cells are few, and not stored.
    set_array(cache, "boxes", empty(8 * most * (9 if plan.cell > BLOCK else 1) * BOX_FLOATS, wp.float32))
    share_witnesses = empty(8 * most * plan.cell_shares * 4, wp.float32)
    schedule = BlockSchedule()
    schedule.room, schedule.parts, schedule.together = room, plan.block_parts, int(plan.together)
    schedule.more = room - 8 * most if plan.by_brick else -1
    schedule.list_split, schedule.at_once = plan.list_split, max(1, plan.split_length // plan.list_split)
    set_array(schedule, "whole", empty(LENGTHS * room, wp.int32))
    set_array(schedule, "coarse", empty(room, wp.int32))
    set_array(schedule, "split_cells", empty(8 * most, wp.int32))
    set_array(schedule, "lacking", empty(8 * most, wp.int32))
    blocks = _lists(9 * room, plan.block_shares, empty)
    pool = ChunkPool()
    pool.chunks = plan.chunks
    set_array(pool, "entries", empty(plan.chunks * CHUNK, wp.int32))
    counted: Any = empty(ZEROS, wp.int32) if zeros is None else zeros
    counters, missed = counted[:COUNTS], counted[COUNTS:]
    set_array(pool, "counters", counters)
    set_array(schedule, "counters", counters)
    return Workspace(grid, counted, counters, missed, cache, pool, regions, cells, share_witnesses, schedule, blocks)


def _lists(count: int, shares: int, empty: Callable[[int, Any], wp.array]) -> Any:
    """So many candidate lists, of so many chains each."""
    lists = CandidateLists()
    lists.shares = shares
    set_array(lists, "heads", empty(count * shares, wp.int32))
    set_array(lists, "lengths", empty(count * shares, wp.int32))
    return lists
