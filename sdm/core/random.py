"""Seeds that torch takes."""

from __future__ import annotations


def torch_seed(seed: int) -> int:
    """A seed for `torch.manual_seed`: any whole number as it is if torch takes it, else its lowest 63 bits."""
    return seed if -(2**63) <= seed < 2**64 else seed & (2**63 - 1)
