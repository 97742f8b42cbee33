"""Shards of a folder's items: what jobs that go through the files of a folder have in common."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from sdm.errors import SDMError
from sdm.runtime.pipeline.stage_times import StageTimes


class ShardTold(NamedTuple):
    """Report of a shard.

    Args:
        number: Of the shard.
        items: What there is to tell of each of its items.
        process: Who did it.
        times: What the clock of that process tells.
    """

    number: int
    items: list[Any]
    process: str
    times: tuple[dict[str, int], dict[str, float]]


def this_process() -> str:
    """Name of this process in reports of shards."""
    return f"{platform.node()} {os.getpid()}"


@dataclass(frozen=True, eq=False, kw_only=True)
class FolderJob:
    """Items in shards.

    Args:
        wanted: Numbers of the items to do.
        each: Items of a shard.
        kinds: Of the devices that have said that they will work.
    """

    wanted: list[int]
    each: int
    kinds: set[str] = field(default_factory=set)

    @property
    def shards(self) -> list[int]:
        """Numbers of the shards."""
        return list(range(-(-len(self.wanted) // self.each)))

    def numbers(self, shard: int) -> list[int]:
        """Numbers of a shard's items."""
        return self.wanted[shard * self.each : (shard + 1) * self.each]

    def agree(self, kind: str) -> None:
        """See `SharedJob`. What is in one folder has the last bits of one kind of device."""
        self.kinds.add(kind)
        if len(self.kinds) > 1:
            both = " and ".join(sorted(self.kinds))
            raise SDMError(f"the cluster has both {both}: the files of a folder are made on one kind of device")

    def run_items(
        self,
        shards: Iterable[int],
        work: Callable[[Iterator[int]], Iterable[Any]],
        done: Callable[[ShardTold], None],
        times: StageTimes,
    ) -> None:
        """Do shards one after the other without a gap.

        Args:
            shards: Their numbers, each asked for when there is room for it.
            work: Does items by their numbers, and tells of each in the same order.
            done: Called with what there is to tell of each shard.
            times: The clock of the work.
        """
        begun: list[int] = []

        def numbers() -> Iterator[int]:
            for shard in shards:
                begun.append(shard)
                yield from self.numbers(shard)

        told: list[Any] = []
        for one in work(numbers()):
            told.append(one)
            if len(told) == len(self.numbers(begun[0])):
                done(ShardTold(begun.pop(0), told, this_process(), times.told()))
                told = []


def require_seen(read: Path, write_to: Path) -> None:
    """See that this machine has a file to read and the folder to write to.

    Raises:
        SDMError: It has not.
    """
    for what, place in (("read from", read), ("write to", write_to)):
        if not place.exists():
            raise SDMError(f"a machine of the cluster does not see {place}: {what} a disk that all of them share")
