"""Freezing of a stream into a dataset of the same samples."""

from __future__ import annotations

from pathlib import Path

from sdm.dataset.writer import Progress, generate
from sdm.errors import SDMError
from sdm.stream import SDMStream


def freeze(
    stream: SDMStream,
    count: int,
    path: str | Path,
    *,
    shard: int | None = None,
    compression: str = "zstd",
    ray: str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write the samples number 0 to `count` - 1 of a stream, bit for bit as it yields them, wherever it is now.

    Args:
        stream: Its family, grid, seed, sampler, type, truncation and signs are taken; it is left where it is.
        count: How many samples.
        path: The dataset to write, for example "cochlea.zarr".
        shard: As of `generate`.
        compression: As of `generate`.
        ray: As of `generate`; without it, the stream's device makes them.
        resume: As of `generate`.
        progress: As of `generate`.

    Returns:
        `path`, for `SDMDataset(path)`.

    Raises:
        FormatError: As of `generate`.
        SDMError: As of `generate`.
    """
    if not isinstance(stream, SDMStream):
        raise SDMError(f"an object of type {type(stream).__name__} is no stream: give an SDMStream")
    maker = stream.maker
    return generate(
        maker.family,
        maker.grid,
        count,
        path,
        seed=maker.seed,
        sampler=maker.sampler,
        dtype=maker.dtype,
        truncate=maker.truncate,
        sign=maker.signs.sign,
        hole_size=maker.signs.hole_size,
        device=maker.device,
        shard=shard,
        compression=compression,
        ray=ray,
        resume=resume,
        progress=progress,
    )
