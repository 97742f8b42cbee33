"""Answers of several workers, given on in the order of their shards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class InOrder:
    """Holds what comes too early.

    Args:
        shards: The shards in their order.
        give: Called with each shard's answer, in that order.
    """

    def __init__(self, shards: list[int], give: Callable[[Any], None]) -> None:
        self._left, self._give = list(reversed(shards)), give
        self._held: dict[int, Any] = {}

    def __call__(self, answer: tuple[int, Any]) -> None:
        """A shard, and what was told of it."""
        number, told = answer
        self._held[number] = told
        while self._left and self._left[-1] in self._held:
            self._give(self._held.pop(self._left.pop()))
