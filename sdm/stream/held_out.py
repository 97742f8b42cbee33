"""Shapes held out for validation: one of 128 parameter vectors, told by a hash, which no random sampler gives."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

# One of so many is held out.
SHARE = 128
# One in `SHARE`, a power of two, ends in bits that are all zero.
LAST = np.uint64(SHARE - 1)
# Of SplitMix64.
SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)
GAMMA, FIRST, SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def is_held_out(theta: Tensor) -> Tensor:
    """True (B,) for the rows of theta (B,P) float32, on the host, that are held out.

    A function of the row's bits alone. It treats all places of the box alike, so what is left of a distribution is
    distributed as before.
    """
    return torch.from_numpy(held_out_rows(theta.detach().numpy()))


def held_out_rows(theta: np.ndarray) -> np.ndarray:
    """`is_held_out` of an array (B,P) float32: True (B,) where a row is held out."""
    # Adding 0 turns -0 into 0, which it is equal to.
    bits = np.add(theta, np.float32(0), order="C").view(np.uint32)
    word = _mix(bits + _columns(bits.shape[1]))
    return _mix(np.add.reduce(word, axis=1)) & LAST == 0


@cache
def _columns(width: int) -> np.ndarray:
    return np.arange(1, width + 1, dtype=np.uint64) * GAMMA


def _mix(word: np.ndarray) -> np.ndarray:
    """The finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014) of uint64 words, in their place."""
    # Streams wait for this: it allocates little.
    part = word >> SHIFTS[0]
    word ^= part
    word *= FIRST
    word ^= np.right_shift(word, SHIFTS[1], out=part)
    word *= SECOND
    word ^= np.right_shift(word, SHIFTS[2], out=part)
    return word
