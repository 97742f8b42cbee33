"""Seeds for one purpose each, and generators of random numbers that start from them."""

from __future__ import annotations

import hashlib
import operator
from typing import SupportsIndex

import torch

from sdm.errors import SDMError


def derive_seed(seed: SupportsIndex, *what: str | SupportsIndex) -> int:
    """Seed of 63 bits for one purpose: a hash of a user's seed and of what the random numbers are for.

    Args:
        seed: Any whole number, however long or negative; no two give the same result.
        what: The purpose, in words and whole numbers: a name that nothing else in the project has, then for example
            the step of a training and the place in the batch.

    Returns:
        0 or more and below 2^63, the first bits of a SHA-256: what `torch.manual_seed`, `numpy.random.default_rng` and
        `sdm.shapes.uniform` take. Neighbouring seeds, steps and places have nothing in common, and
        `("a", "b")`, `("ab",)`, `1` and `"1"` are four purposes.

    Raises:
        SDMError: The seed is no whole number.
    """
    try:
        number = operator.index(seed)
    except TypeError:
        raise SDMError(f"the seed is {seed!r}; give a whole number") from None
    digest = hashlib.sha256(b"".join(_encoded(part) for part in (number, *what))).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def generator(seed: SupportsIndex, *what: str | SupportsIndex, device: torch.device | str = "cpu") -> torch.Generator:
    """A generator of torch's that starts from `derive_seed(seed, *what)`.

    torch's generator of the CPU keeps the lower 32 bits of its seed, so of many thousand purposes two may share theirs
    by chance; none do so by their distance.
    """
    return torch.Generator(device).manual_seed(derive_seed(seed, *what))


def _encoded(part: str | SupportsIndex) -> bytes:
    """A word or a whole number with its type and length before it, so that no two sequences of them are alike."""
    # Hexadecimal digits, since decimal ones of long numbers are refused.
    kind, text = ("s", part) if isinstance(part, str) else ("i", format(operator.index(part), "x"))
    content = text.encode("utf-8", "surrogatepass")
    return f"{kind}{len(content)}:".encode() + content
