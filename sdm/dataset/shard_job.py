"""The work on one shard, on one device: what every way of sharing out shards has in common."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.dataset.layout import rows_of, write_shard
from sdm.engine.arguments import Sign
from sdm.errors import FormatError
from sdm.runtime.prefetch import prefetch
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

    def run(self, shards: Iterable[int], maker: Maker, done: Callable[[int], None]) -> None:
        """Make and write shards; `done(number)` is called for each that is on the disk.

        While one shard is written, the next is made.

        Raises:
            FormatError: The disk is full, or cannot be written.
        """
        scratch = self.folder / f".{os.getpid()}-{secrets.token_hex(4)}.part"
        try:
            scratch.mkdir()
            with ThreadPoolExecutor(1, thread_name_prefix="sdm-shard") as writer:
                waiting: tuple[int, Future[None]] | None = None
                for number in shards:
                    content = self._make(number, maker)
                    if waiting is not None:
                        waiting[1].result()
                        done(waiting[0])
                    waiting = number, writer.submit(self._write, number, *content, scratch)
                    del content
                if waiting is not None:
                    waiting[1].result()
                    done(waiting[0])
        except OSError as error:
            why = error.strerror or error
            raise FormatError(f"{self.folder} cannot be written: {why}; --resume goes on from there") from error
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def _write(
        self, number: int, theta: np.ndarray, transform: np.ndarray | None, maps: np.ndarray, scratch: Path
    ) -> None:
        write_shard(self.folder, self.manifest, number, theta, transform, maps, scratch)

    def _make(self, number: int, maker: Maker) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        begin, end = rows_of(self.manifest, number)
        theta = maker.theta(_numbers(begin, end))
        maps = torch.empty((end - begin, *self.grid.shape), dtype=self.dtype, device="cpu")
        for first, batch in self._batches(begin, end, maker):
            maps[first - begin : first - begin + len(batch.index)] = batch.sdm[:, 0]
        transform = self.family.sample_transforms(theta)
        return theta.numpy(), None if transform is None else transform.numpy(), maps.numpy()

    def _batches(self, begin: int, end: int, maker: Maker) -> Iterator[tuple[int, Batch]]:
        size = maker.at_once

        def make(several: list[int]) -> list[Batch]:
            return [maker.make(_numbers(first, min(first + size, end))) for first in several]

        return prefetch(make, iter(range(begin, end, size)), maker.device, 1)


def _numbers(begin: int, end: int) -> Tensor:
    return torch.arange(begin, end, dtype=torch.int64, device="cpu")
