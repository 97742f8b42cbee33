"""Shapes of a training step: a pure function of seed and step, for any number of ranks that divides a batch."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.core.random import generator
from sdm.errors import SDMError


class Batches:
    """Every epoch goes through all shapes in a new order, whole batches only.

    Args:
        count: Number of shapes.
        size: Shapes of a batch over all ranks; fewer where there are not that many. Each rank has as many as any
            other: what `world` does not divide is left out of the batch, 1 of 64 for 3 processes.
        seed: Of the order.
        rank: This process.
        world: Processes. Each takes every `world`-th shape of the batch.

    Raises:
        SDMError: Fewer shapes than processes.
    """

    def __init__(self, count: int, size: int, seed: int, rank: int = 0, world: int = 1) -> None:
        self._size = min(size, count) // world * world
        if self._size == 0:
            raise SDMError(f"a batch of {min(size, count)} shapes cannot be shared by {world} processes; use fewer")
        self._count, self._seed, self._rank, self._world = count, seed, rank, world

    @property
    def per_epoch(self) -> int:
        """Steps of an epoch."""
        return self._count // self._size

    def __getitem__(self, step: int) -> Tensor:
        """The shapes (B,) int64 of this process in a step, on the host."""
        epoch, place = divmod(step, self.per_epoch)
        random = generator(self._seed, "DeepSDF order", epoch)
        order = torch.randperm(self._count, generator=random, device="cpu")
        return order[place * self._size : (place + 1) * self._size][self._rank :: self._world]
