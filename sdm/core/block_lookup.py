"""Places of blocks of 8^3 voxels in sorted lists: which one is stored where, and what lies inside where none is."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Int, Int32, Int64
from torch import Tensor

# Voxels along the edge of a block.
BLOCK = 8


def blocks_along(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    """Blocks along each axis of a grid of this shape; the last ones may stick out."""
    return (-(-shape[0] // BLOCK), -(-shape[1] // BLOCK), -(-shape[2] // BLOCK))


def keys_of(blocks: Int[Tensor, "*n 3"], count: tuple[int, int, int]) -> Int64[Tensor, "*n"]:
    """Numbers by which blocks (...,3) are sorted: by x, then y, then z; there are `count` along the axes."""
    x, y, z = blocks.long().unbind(-1)
    return (x * count[1] + y) * count[2] + z


def blocks_of(keys: Int64[Tensor, " n"], count: tuple[int, int, int]) -> Int32[Tensor, "n 3"]:
    """The blocks (N,3) that these numbers belong to."""
    rest = keys // count[2]
    return torch.stack([rest // count[1], rest % count[1], keys % count[2]], -1).int()


def find_blocks(sorted_keys: Int64[Tensor, " n"], wanted: Int64[Tensor, "*m"]) -> Int64[Tensor, "*m"]:
    """Places of the `wanted` keys in a sorted list, or -1 where it does not have one."""
    if not len(sorted_keys):
        return torch.full_like(wanted, -1)
    at = torch.searchsorted(sorted_keys, wanted).clamp(max=len(sorted_keys) - 1)
    return torch.where(sorted_keys[at] == wanted, at, -1)


def are_in_runs(
    runs: Int32[Tensor, "r 4"], wanted: Int64[Tensor, "*m"], count: tuple[int, int, int]
) -> Bool[Tensor, "*m"]:
    """True for keys of blocks in one of the sorted runs (R,4): x and y, the first z, and the one after the last."""
    if not len(runs):
        return torch.zeros_like(wanted, dtype=torch.bool)
    first = keys_of(runs[:, :3], count)
    end = first + (runs[:, 3] - runs[:, 2])
    at = torch.searchsorted(first, wanted, right=True) - 1
    return (at >= 0) & (wanted < end[at.clamp(min=0)])


def gaps_of(keys: Int64[Tensor, " n"], count: tuple[int, int, int]) -> tuple[Int64[Tensor, " m"], Int64[Tensor, " m"]]:
    """Runs of blocks along z between stored ones, or between those and the grid's ends, in rows that have any.

    Returns:
        Their first keys, ascending, and the keys after their last.
    """
    row = torch.div(keys, count[2], rounding_mode="floor")
    new_row = torch.ones_like(keys, dtype=torch.bool)
    new_row[1:] = row[1:] != row[:-1]
    # Before the first of a row, and after every one.
    following = torch.where(new_row.roll(-1), (row + 1) * count[2], keys.roll(-1))
    begin = torch.cat([(row * count[2])[new_row], keys + 1])
    end = torch.cat([keys[new_row], following])
    begin, end = begin[end > begin], end[end > begin]
    order = begin.argsort()
    return begin[order], end[order]


def joined_runs(runs: Int32[Tensor, "r 4"], count: tuple[int, int, int]) -> Int32[Tensor, "s 4"]:
    """The same runs, sorted, those that follow each other as one."""
    row: Int64[Tensor, " r"] = runs[:, 0].long() * count[1] + runs[:, 1]
    order = (row * count[2] + runs[:, 2]).argsort()
    runs, row = runs[order], row[order]
    if not len(runs):
        return runs
    begins = torch.ones(len(runs), dtype=torch.bool, device=runs.device)
    begins[1:] = (row[1:] != row[:-1]) | (runs[1:, 2] != runs[:-1, 3])
    ends = begins.roll(-1)
    ends[-1] = True
    return torch.cat([runs[begins][:, :3], runs[ends][:, 3:]], 1)
