"""The work on one shard, on one device: what every way of sharing out shards has in common."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.dataset.layout import rows_of, write_shard
from sdm.dataset.manifest import KEY, sealed
from sdm.engine.arguments import Sign
from sdm.errors import FormatError, SDMError
from sdm.io.files.atomic import put
from sdm.io.files.stand_in import StandIn, adopt
from sdm.runtime.host_copy import HostRows
from sdm.runtime.pipeline.outcome import Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_threads, numbered, one_by_one
from sdm.runtime.pipeline.thread_count import threads_beside
from sdm.runtime.prefetch import prefetch
from sdm.runtime.sharing.folder_job import ShardTold, this_process
from sdm.shapes import Family
from sdm.stream import Batch, Maker, Sampler

# Shards that are compressed and written at a time; each is 256 MiB of memory, if nobody says otherwise. A thread
# takes 0.5 to 1 ms for the SHA-256 of a megabyte.
WRITERS = 6
# Shards of a GPU that are made while all writers are busy, so that none of them waits for the next one.
READY = 2


class _Shard(NamedTuple):
    """A shard on its way to the disk: the number, parameters (n,P), transforms (n,4,4), maps (n,nx,ny,nz)."""

    number: int
    theta: np.ndarray
    transform: np.ndarray | None
    maps: HostRows


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
        threads = threads_beside(maker.device)
        writers = min(threads, WRITERS)
        try:
            scratch.mkdir()
            with ThreadPoolExecutor(threads, thread_name_prefix="sdm-compress") as pool:
                made = one_by_one(
                    numbered(shards), str(maker.device), lambda number: self._make(number, maker), times=times
                )
                written = in_threads(
                    made,
                    "write",
                    lambda shard: self._write(shard, scratch, pool),
                    workers=writers,
                    most_held=writers + (READY if maker.device.type == "cuda" else 0),
                    times=times,
                    prompt=True,
                )
                for outcome in written:
                    if isinstance(outcome, Failed):
                        raise outcome.error
                    done(ShardTold(outcome.value, [], this_process(), times.told()))
        except OSError as error:
            why = error.strerror or error
            raise FormatError(f"{self.folder} cannot be written: {why}; --resume goes on from there") from error
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def _write(self, shard: _Shard, scratch: Path, pool: Executor) -> int:
        maps = shard.maps.wait()
        write_shard(self.folder, self.manifest, shard.number, shard.theta, shard.transform, maps, scratch, pool)
        return shard.number

    def _make(self, number: int, maker: Maker) -> _Shard:
        begin, end = rows_of(self.manifest, number)
        theta = maker.theta(_numbers(begin, end))
        maps = HostRows((end - begin, *self.grid.shape), self.dtype, maker.device)
        for first, batch in self._batches(begin, theta, maker):
            maps.put(first - begin, batch.sdm[:, 0])
        transform = self.family.sample_transforms(theta)
        return _Shard(number, theta.numpy(), None if transform is None else transform.numpy(), maps)

    def _batches(self, begin: int, theta: Tensor, maker: Maker) -> Iterator[tuple[int, Batch]]:
        size, end = maker.at_once, begin + len(theta)

        def make(several: list[int]) -> list[Batch]:
            parts = [(first, min(first + size, end)) for first in several]
            return [maker.make(_numbers(*part), theta[part[0] - begin : part[1] - begin]) for part in parts]

        return prefetch(make, iter(range(begin, end, size)), maker.device, 1)


def _numbers(begin: int, end: int) -> Tensor:
    return torch.arange(begin, end, dtype=torch.int64, device="cpu")
