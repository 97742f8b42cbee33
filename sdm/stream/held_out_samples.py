"""Samples that are held out for validation, drawn from a family."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.errors import SDMError
from sdm.shapes import Family
from sdm.stream.held_out import is_held_out
from sdm.stream.samplers import Sampler

# Candidates that are drawn at a time, and how often before a family counts as too small.
BLOCK, MOST_BLOCKS = 8192, 64


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
