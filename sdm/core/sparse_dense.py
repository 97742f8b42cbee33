"""Dense values of a box of a narrow band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from sdm.core.block_lookup import BLOCK

if TYPE_CHECKING:
    from sdm.core.sparse_sdm import SparseSDM


def dense_values(band: SparseSDM, begin: tuple[int, int, int], end: tuple[int, int, int]) -> Float[Tensor, "nx ny nz"]:
    """Values of the voxels from `begin` on, before `end`."""
    low = [n // BLOCK for n in begin]
    count = [-(-n // BLOCK) - first for n, first in zip(end, low, strict=True)]
    device = band.device
    first = torch.tensor(low, device=device)
    size = torch.tensor(count, device=device)
    # Of each block, then of each of its voxels.
    coarse = torch.full(count, band.width, dtype=band.values.dtype, device=device)
    _mark_inside(coarse, band, low, count)
    room = coarse[:, None, :, None, :, None].expand(count[0], BLOCK, count[1], BLOCK, count[2], BLOCK).contiguous()
    place = band.blocks - first
    within = ((place >= 0) & (place < size)).all(-1)
    x, y, z = place[within].long().unbind(-1)
    # A new tensor, so that gradients flow to the values.
    whole = room.permute(0, 2, 4, 1, 3, 5).index_put((x, y, z), band.values[within])
    whole = whole.permute(0, 3, 1, 4, 2, 5).reshape(*(BLOCK * n for n in count))
    cut = [slice(b - BLOCK * f, e - BLOCK * f) for b, e, f in zip(begin, end, low, strict=True)]
    return whole[tuple(cut)].contiguous()


def _mark_inside(coarse: Tensor, band: SparseSDM, low: list[int], count: list[int]) -> None:
    """Minus the width in the blocks of the box that lie inside and are not stored."""
    if not len(band.inside):
        return
    x, y, begin, end = (band.inside.long() - torch.tensor([*low, low[2]], device=band.device)).unbind(-1)
    begin, end = begin.clamp(0, count[2]), end.clamp(0, count[2])
    there = (x >= 0) & (x < count[0]) & (y >= 0) & (y < count[1]) & (end > begin)
    x, y, begin, end = x[there], y[there], begin[there], end[there]
    # A run begins where it adds one, and ends where it takes it away.
    steps = torch.zeros((count[0], count[1], count[2] + 1), dtype=torch.int32, device=band.device)
    one = torch.ones_like(x, dtype=torch.int32)
    steps.index_put_((x, y, begin), one, accumulate=True)
    steps.index_put_((x, y, end), -one, accumulate=True)
    coarse[steps.cumsum(-1)[..., :-1] > 0] = -band.width
