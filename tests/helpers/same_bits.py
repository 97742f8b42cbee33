"""Maps that should be the same bit for bit: where they are not, how many voxels differ, and by how much."""

from __future__ import annotations

import torch
from torch import Tensor


def ulps_between(one: Tensor, other: Tensor) -> Tensor:
    """Steps from float32 to the next one, from the values of one tensor to those of another, int64; zeros are one."""
    bits = (tensor.detach().cpu().float().contiguous().view(torch.int32).long() for tensor in (one, other))
    first, second = (torch.where(b < 0, -(b & 0x7FFFFFFF), b) for b in bits)
    return (first - second).abs()


def difference(found: Tensor, wanted: Tensor) -> str:
    """Difference of two maps, as a sentence; empty if there is none. NaN equals NaN."""
    if found.shape != wanted.shape:
        return f"the shape is {tuple(found.shape)} and not {tuple(wanted.shape)}"
    found, wanted = found.detach().cpu(), wanted.detach().cpu()
    other = (found != wanted) & ~(found.isnan() & wanted.isnan())
    places = other.nonzero()
    if not len(places):
        return ""
    mine, theirs = found[other], wanted[other]
    turned = int(((mine < 0) != (theirs < 0)).sum())
    # Apart from signs, as a voxel on the other side is far off in any count.
    ulps = ulps_between(mine.abs(), theirs.abs())
    worst = int(ulps.argmax())
    at = tuple(places[worst].tolist())
    return (
        f"{len(places)} of {found.numel()} values differ, {turned} of them in sign; the sizes by {int(ulps.max())} ulp "
        f"at most (median {int(ulps.median())}), as at {at}: {mine[worst].item()!r} and not {theirs[worst].item()!r}"
    )


def assert_same_bits(found: Tensor, wanted: Tensor, where: object) -> None:
    """Fail with the difference of two maps, if there is any, and with which they are."""
    text = difference(found, wanted)
    assert not text, f"{where}: {text}"
