"""Bands in `.zarr` (version 3): a group with the arrays blocks, values and inside."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from sdm.core.grid import Grid
from sdm.core.sparse_sdm import SparseSDM
from sdm.errors import FormatError
from sdm.io.bands.band_record import ARRAYS, arrays_of, band_from, band_record
from sdm.io.maps.record import BAND_KEY, MADE_FROM, NO_VALUES, from_record, verify, with_checksum

# Voxels along an edge of a block.
BLOCK = 8
# Rows of a chunk: 8 MiB of values.
ROWS = 1 << 12
# Numbers in a chunk that others may have made, where the array is smaller.
MOST_OF_A_CHUNK = 1 << 28


def write(band: SparseSDM, path: Path, made_from: str | None = None) -> None:
    """Write a band."""
    group = zarr.create_group(store=path)
    for name, values in arrays_of(band).items():
        array = group.create_array(
            name=name,
            shape=values.shape,
            chunks=(max(1, min(ROWS, len(values))), *values.shape[1:]),
            dtype=values.dtype,
            compressors=[ZstdCodec(level=0), Crc32cCodec()],
            fill_value=float("nan") if values.dtype.kind == "f" else -1,
            config={"write_empty_chunks": True},
        )
        if len(values):
            array[:] = values
    group.attrs[BAND_KEY] = with_checksum(band_record(band, made_from), NO_VALUES)


def read(path: Path) -> SparseSDM:
    """Read a band."""
    group = zarr.open_group(path, mode="r")
    kept = group.attrs.get(BAND_KEY)
    verify(kept, NO_VALUES, str(path))
    most = math.prod(-(-n // BLOCK) for n in from_record(kept, str(path))[0].shape)
    arrays = {name: _read(group, name, most, path) for name in ARRAYS}
    return band_from(kept, arrays, str(path))


def read_origin(path: Path) -> tuple[Grid, str | None]:
    """The grid, and the digest of the mesh."""
    kept: Any = zarr.open_group(path, mode="r").attrs.get(BAND_KEY)
    verify(kept, NO_VALUES, str(path))
    return from_record(kept, str(path))[0], kept.get(MADE_FROM)


def _read(group: zarr.Group, name: str, most: int, path: Path) -> torch.Tensor:
    """One of the arrays, which has `most` rows at most."""
    array: Any = group[name]
    # Before anything goes over the chunks, which may be said to be as many as nobody has time for.
    if array.shape[0] > most or math.prod(array.shape[1:]) > BLOCK**3:
        raise FormatError(f"{path} is damaged: its {name} would have the shape {array.shape}")
    if math.prod(array.chunks) > max(array.size, MOST_OF_A_CHUNK):
        raise FormatError(f"{path} is damaged: a chunk of its {name} would have the shape {array.chunks}")
    # Zarr reads a chunk that is gone as the fill value, without a word.
    if array.size and (lost := array.nchunks - array.nchunks_initialized):
        raise FormatError(f"{path} has lost {lost:,} of its {array.nchunks:,} chunks: copy or compute the band again")
    return torch.from_numpy(np.ascontiguousarray(array[:], dtype=ARRAYS[name]))


def is_band(path: Path) -> bool:
    """True if a folder has a band."""
    opened = zarr.open(path, mode="r")
    return isinstance(opened, zarr.Group) and BAND_KEY in opened.attrs
