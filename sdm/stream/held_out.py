"""Shapes held out for validation: one of 128 parameter vectors, told by a hash, which no random sampler gives."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from sdm.errors import SDMError
from sdm.shapes import Family

if TYPE_CHECKING:
    from sdm.stream.samplers import Sampler

# One of so many is held out.
SHARE = 128
# Candidates that are drawn at a time, and how often before a family counts as too small.
BLOCK, MOST_BLOCKS = 8192, 64
# Of SplitMix64.
GAMMA, FIRST, SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def is_held_out(theta: Tensor) -> Tensor:
    """True (B,) for the rows of theta (B,P) float32, on the host, that are held out.

    A function of the row's bits alone. It treats all places of the box alike, so what is left of a distribution is
    distributed as before.
    """
    # Adding 0 turns -0 into 0, which it is equal to.
    bits = (theta.detach() + 0.0).contiguous().numpy().view(np.uint32).astype(np.uint64)
    columns = np.arange(1, bits.shape[1] + 1, dtype=np.uint64) * GAMMA
    word = _mixed(_mixed(bits + columns).sum(1, dtype=np.uint64))
    return torch.from_numpy(word % np.uint64(SHARE) == 0)


def held_out_samples(family: Family, count: int, seed: int, static: Sampler | None = None) -> Tensor:
    """theta (count,P) float32 on the host: the first held-out ones among the family's uniform samples of `seed`.

    Args:
        family: The shapes.
        count: Number of samples.
        seed: Any whole number.
        static: A sampler that may give held-out samples, such as a table: those are left out too.

    Raises:
        SDMError: The family has so few different shapes that none of them is held out.
    """
    found, missing = [], count
    for block in range(MOST_BLOCKS):
        if missing <= 0:
            break
        theta = family.sample_at(torch.arange(block * BLOCK, (block + 1) * BLOCK, device="cpu"), seed=seed)
        theta = theta[is_held_out(theta)]
        if static is not None:
            theta = theta[~static.includes(family, theta)]
        found.append(theta[:missing])
        missing -= len(found[-1])
    if missing > 0:
        raise SDMError(
            f"{family.name} has too few different shapes to hold {count} of them out for validation: "
            "give its parameters wider ranges"
        )
    return torch.cat(found) if found else torch.empty(0, len(family.parameters), device="cpu")


def _mixed(word: np.ndarray) -> np.ndarray:
    """The finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014) of uint64 words."""
    word = (word ^ (word >> np.uint64(30))) * FIRST
    word = (word ^ (word >> np.uint64(27))) * SECOND
    return word ^ (word >> np.uint64(31))
