"""The work on one shard, on one device: what every way of sharing out shards has in common."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from operator import length_hint
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.dataset.layout import shard_count
from sdm.dataset.manifest import KEY, sealed
from sdm.dataset.shard_paths import rows_of
from sdm.dataset.shard_stage import Shard, ShardWriters, shard_writers
from sdm.engine.arguments import Sign
from sdm.errors import FormatError, SDMError
from sdm.io.files.atomic import put
from sdm.io.files.stand_in import StandIn, address_of, adopt
from sdm.runtime.host_copy import HostRows
from sdm.runtime.pipeline.outcome import Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_threads, numbered, one_by_one
from sdm.runtime.prefetch import prefetch
from sdm.runtime.sharing.folder_job import ShardTold, this_process
from sdm.shapes import Family
from sdm.stream import Batch, Maker, Sampler


@dataclass(frozen=True, eq=False)
class Job:
    """All that a process needs to know to make shards.

    Args:
        folder: The dataset.
        manifest: Its manifest.
        family: The shapes.
        grid: Where to measure.
        sampler: Which parameters.
        seed: Of the samples.
        dtype: Of the maps.
        truncate: Largest distance, None for any.
        sign: The method by which maps are signed.
        hole_size: Of a flood.
        stand_ins: Paths that stand for addresses, for other processes.
    """

    folder: Path
    manifest: dict[str, Any]
    family: Family
    grid: Grid
    sampler: Sampler
    seed: int
    dtype: torch.dtype
    truncate: float | None
    sign: Sign = "winding"
    hole_size: float | None = None
    stand_ins: tuple[StandIn, ...] = ()

    def absolute(self) -> Job:
        """See `SharedJob`."""
        return replace(self, folder=self.folder.absolute())

    def check(self) -> None:
        """See `SharedJob`."""
        if not (self.folder / "zarr.json").is_file():
            raise SDMError(
                f"a machine of the cluster does not see {self.folder}: write to a disk that all of them share"
            )

    def agree(self, kind: str) -> None:
        """See `SharedJob`. All devices must be of one kind, or the shards would differ in their last bits."""
        if self.manifest["device"] is None:
            self.manifest["device"] = kind
            path = self.folder / "zarr.json"
            text = json.loads(path.read_text())
            text["attributes"][KEY] = sealed({**text["attributes"][KEY], "device": kind})
            put(path, json.dumps(text, indent=2).encode())
        if kind != self.manifest["device"]:
            raise SDMError(
                f"the cluster has both {self.manifest['device']} and {kind}: a dataset is made on one kind of device"
            )

    def maker(self, device: str | torch.device) -> Maker:
        """Makes the samples."""
        return Maker(
            self.family,
            self.grid,
            seed=self.seed,
            sampler=self.sampler,
            device=device,
            dtype=self.dtype,
            truncate=self.truncate,
            sign=self.sign,
            hole_size=self.hole_size,
        )

    def run(
        self, shards: Iterable[int], maker: Maker, done: Callable[[ShardTold], None], *, times: StageTimes | None = None
    ) -> None:
        """Make and write shards; `done` is called with the report of each that is on the disk, in their order.

        While some shards are compressed and written, the next is made.

        Raises:
            FormatError: The disk is full, or cannot be written.
        """
        times = StageTimes() if times is None else times
        adopt(self.stand_ins)
        scratch = self.folder / f".{os.getpid()}-{secrets.token_hex(4)}.part"
        # Of an iterator nobody knows; then there are many.
        count = length_hint(shards, shard_count(self.manifest))
        local = address_of(self.folder) is None
        try:
            scratch.mkdir()
            with ExitStack() as stack:
                how = shard_writers(self.folder, self.manifest, scratch, maker.device, shards=count, local=local)
                writers = stack.enter_context(how)
                made = one_by_one(
                    numbered(shards), str(maker.device), lambda number: self._make(number, maker, writers), times=times
                )
                written = in_threads(
                    made,
                    "write",
                    lambda shard: self._write(shard, writers),
                    workers=writers.count,
                    most_held=writers.held,
                    times=times,
                    prompt=True,
                )
                # Nobody writes any more when writers end.
                for outcome in stack.enter_context(closing(written)):
                    if isinstance(outcome, Failed):
                        raise outcome.error
                    done(ShardTold(outcome.value, [], this_process(), times.told()))
        except OSError as error:
            why = error.strerror or error
            raise FormatError(f"{self.folder} cannot be written: {why}; --resume goes on from there") from error
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def _write(self, shard: Shard, writers: ShardWriters) -> int:
        writers.write(shard)
        return shard.number

    def _make(self, number: int, maker: Maker, writers: ShardWriters) -> Shard:
        begin, end = rows_of(self.manifest, number)
        theta = maker.theta(_numbers(begin, end))
        memory = writers.memory()
        room = None if memory is None else memory.content
        maps = HostRows((end - begin, *self.grid.shape), self.dtype, maker.device, memory=room)
        for first, batch in self._batches(begin, theta, maker):
            maps.put(first - begin, batch.sdm[:, 0])
        transform = self.family.sample_transforms(theta)
        return Shard(number, theta.numpy(), None if transform is None else transform.numpy(), maps, memory)

    def _batches(self, begin: int, theta: Tensor, maker: Maker) -> Iterator[tuple[int, Batch]]:
        size, end = maker.at_once, begin + len(theta)

        def make(several: list[int]) -> list[Batch]:
            parts = [(first, min(first + size, end)) for first in several]
            return [maker.make(_numbers(*part), theta[part[0] - begin : part[1] - begin]) for part in parts]

        return prefetch(make, iter(range(begin, end, size)), maker.device, 1)


def _numbers(begin: int, end: int) -> Tensor:
    return torch.arange(begin, end, dtype=torch.int64, device="cpu")
