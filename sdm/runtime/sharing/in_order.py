"""Answers of several workers, given on in the order of their shards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sdm.runtime.sharing.folder_job import ShardTold


class InOrder:
    """Holds what comes too early.

    Args:
        shards: The shards in their order.
        give: Called with what is told of each shard's items, in that order.
    """

    def __init__(self, shards: list[int], give: Callable[[Any], None]) -> None:
        self._left, self._give = list(reversed(shards)), give
        self._held: dict[int, Any] = {}

    def __call__(self, told: ShardTold) -> None:
        """Take the report of a shard."""
        self._held[told.number] = told.items
        while self._left and self._left[-1] in self._held:
            self._give(self._held.pop(self._left.pop()))
