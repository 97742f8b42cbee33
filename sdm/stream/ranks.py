"""Rank of this process and number of processes."""

from __future__ import annotations

import os

import torch.distributed

from sdm.errors import SDMError


def rank_and_size(rank: int | None = None, world_size: int | None = None) -> tuple[int, int]:
    """Rank and number of processes: as given, else torch.distributed's, else torchrun's, else 0 of 1.

    Raises:
        SDMError: One of the two alone, or a rank that is not below the number of processes.
    """
    if (rank is None) != (world_size is None):
        raise SDMError("give rank and world_size both, or neither")
    if rank is None or world_size is None:
        if in_process_group():
            rank, world_size = torch.distributed.get_rank(), torch.distributed.get_world_size()
        else:
            rank, world_size = (
                int(os.environ.get(name, default)) for name, default in (("RANK", 0), ("WORLD_SIZE", 1))
            )
    if not 0 <= rank < world_size:
        raise SDMError(f"the rank is {rank} of {world_size}; ranks are numbered from 0")
    return rank, world_size


def in_process_group() -> bool:
    """True if torch.distributed knows this process's rank."""
    return torch.distributed.is_available() and torch.distributed.is_initialized()
