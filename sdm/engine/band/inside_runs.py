"""Runs of blocks that are not stored and lie inside the mesh."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import torch
import warp as wp
from jaxtyping import Bool, Float, Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along, blocks_of, gaps_of, keys_of
from sdm.core.grid import Grid
from sdm.core.voxel_points import voxel_points
from sdm.kernels.band.block_bits import COUNTS, KEPT, RUNS
from sdm.kernels.band.block_lists import list_inside_gaps
from sdm.runtime.torch_warp import as_warp, workspace

if TYPE_CHECKING:
    from sdm.engine.mesh_index import MeshIndex


def inside_runs(
    index: MeshIndex,
    grid: Grid,
    blocks: Int32[Tensor, "n 3"],
    gaps: Int32[Tensor, "g 4"] | None,
    *,
    beyond: bool,
) -> Int32[Tensor, "r 4"]:
    """Runs (R,4) along z of blocks that are not stored and lie inside, sorted: x and y, first z, one after the last.

    Next to a block that is not stored a closed mesh has no surface, so it is on the side of any voxel that faces it:
    `gaps` are those of its runs, in rows that have a block. Of other meshes winding numbers tell, in the first and the
    last block of a run; where these differ, a bisection finds where they change. Rows without a block are outside,
    unless the mesh reaches `beyond` the grid; then a voxel of each is asked.
    """
    count = blocks_along(grid.shape)
    if gaps is not None:
        if not beyond:
            return gaps
        keys, begin = keys_of(blocks, count), keys_of(gaps[:, :3], count)
        end = begin + (gaps[:, 3] - gaps[:, 2])
    else:
        keys = keys_of(blocks, count)
        begin, end = inner_parts(partial(_are_inside, index, grid), *gaps_of(keys, count))
    if beyond:
        empty = _empty_rows(keys, count)
        empty = empty[_are_inside(index, grid, empty * count[2] + count[2] // 2)]
        begin = torch.cat([begin, empty * count[2]])
        end = torch.cat([end, (empty + 1) * count[2]])
        order = begin.argsort()
        begin, end = begin[order], end[order]
    return runs_between(begin, end, count)


def gaps_inside(blocks: Int32[Tensor, "n 3"], values: Float[Tensor, "n 8 8 8"], last: int) -> Int32[Tensor, "r 4"]:
    """Runs (R,4) between all blocks of a closed mesh's band that lie inside, sorted; `last` blocks are along z.

    To be called on the current stream.
    """
    runs, kept = blocks.new_empty((2 * len(blocks), 4)), torch.arange(len(blocks), device=blocks.device).int()
    counts, empty = torch.zeros(COUNTS, dtype=torch.int32, device=blocks.device), workspace(blocks.device)
    counts[KEPT] = len(blocks)
    list_inside_gaps(
        as_warp(blocks, wp.vec3i),
        as_warp(kept, wp.int32),
        as_warp(values.view(-1), wp.float32),
        last,
        empty(2 * len(blocks), wp.int32),
        as_warp(runs, wp.vec4i),
        as_warp(counts, wp.int32),
    )
    return runs[: int(counts[RUNS])]


def inner_parts(
    are_inside: Callable[[Tensor], Tensor], begin: Int64[Tensor, " m"], end: Int64[Tensor, " m"]
) -> tuple[Int64[Tensor, " i"], Int64[Tensor, " i"]]:
    """Of runs of blocks those that lie inside, or their parts, if they have one side at either end.

    `are_inside` takes keys (K,) of blocks, and says which are.
    """
    first, last = are_inside(begin), are_inside(end - 1)
    # The last block known to be on the side of the first, and the first known not to be.
    low, high = begin.clone(), torch.where(first == last, end, end - 1)
    while len(at := ((first != last) & (high - low > 1)).nonzero()[:, 0]):
        middle = (low[at] + high[at]) // 2
        same = are_inside(middle) == first[at]
        low[at], high[at] = torch.where(same, middle, low[at]), torch.where(same, high[at], middle)
    inside = first | last
    begin, end = torch.where(first, begin, high), torch.where(last, end, high)
    return begin[inside], end[inside]


def middle_voxels(keys: Int64[Tensor, " m"], grid: Grid) -> Int64[Tensor, "m 3"]:
    """A voxel (M,3) near the middle of each block, by which its side is told."""
    last = torch.tensor(grid.shape, device=keys.device) - 1
    return (blocks_of(keys, blocks_along(grid.shape)).long() * BLOCK + 3).minimum(last)


def runs_between(
    begin: Int64[Tensor, " r"], end: Int64[Tensor, " r"], count: tuple[int, int, int]
) -> Int32[Tensor, "r 4"]:
    """Runs (R,4) along z, given their first keys and those after their last: x and y, first z, one after the last."""
    first = blocks_of(begin, count)
    return torch.cat([first, first[:, 2:] + (end - begin).int()[:, None]], 1)


def all_gaps(keys: Int64[Tensor, " n"], count: tuple[int, int, int]) -> tuple[Int64[Tensor, " m"], Int64[Tensor, " m"]]:
    """`gaps_of` these, and all rows that have none of them: first keys, ascending, and the keys after the last."""
    begin, end = gaps_of(keys, count)
    empty = _empty_rows(keys, count) * count[2]
    begin, end = torch.cat([begin, empty]), torch.cat([end, empty + count[2]])
    order = begin.argsort()
    return begin[order], end[order]


def _are_inside(index: MeshIndex, grid: Grid, keys: Int64[Tensor, " m"]) -> Bool[Tensor, " m"]:
    """True for blocks a voxel of which, near its middle, has a winding number of more than a half."""
    return index.winding_number(voxel_points(grid, middle_voxels(keys, grid))) > 0.5


def _empty_rows(keys: Int64[Tensor, " n"], count: tuple[int, int, int]) -> Int64[Tensor, " m"]:
    rows = torch.ones(count[0] * count[1], dtype=torch.bool, device=keys.device)
    rows[torch.div(keys, count[2], rounding_mode="floor")] = False
    return rows.nonzero()[:, 0]
