"""torch's global random numbers during a training, which dropout and new weights draw from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def own_random_numbers(device: torch.device | str = "cpu") -> Iterator[None]:
    """Leave torch's global generators, of the host and of `device`, as they were."""
    where = torch.device(device)
    with torch.random.fork_rng(devices=[where] if where.type == "cuda" else []):
        yield
