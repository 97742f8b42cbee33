"""`.zarr` (version 3): chunks of a large map, written slab by slab and read in any part."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError
from sdm.io.maps.record import (
    KEY,
    NO_VALUES,
    from_record,
    record,
    sign_arguments,
    signs_of,
    stored_values,
    verify,
    with_checksum,
)

CHUNK = 128
# The engine gives slabs of a multiple of this many layers, and so chunks have it too.
LAYERS = 32
# Bytes of the slabs that a map is written in: what is in memory at a time.
SLAB_BYTES = 1 << 28


def write(field: SDM, path: Path, made_from: str | None = None) -> None:
    """Write a whole map."""
    values = stored_values(field)
    layers = slab_layers(field.grid)
    slabs = ((i, min(i + layers, len(values)), values[i : i + layers]) for i in range(0, len(values), layers))
    write_slabs(slabs, field.grid, path, lambda: field.ambiguous_voxels, made_from, signs_of(field), values.dtype.name)


def slab_layers(grid: Grid) -> int:
    """Layers of voxels along the first axis that a slab should have: whole chunks, as far as `SLAB_BYTES` allow."""
    fit = SLAB_BYTES // (4 * grid.shape[1] * grid.shape[2])
    return fit // CHUNK * CHUNK if fit > CHUNK else max(LAYERS, fit // LAYERS * LAYERS)


def write_slabs(
    slabs: Iterable[tuple[int, int, Any]],
    grid: Grid,
    path: Path,
    ambiguous_voxels: Callable[[], int | None],
    made_from: str | None = None,
    signs: dict[str, Any] | None = None,
    dtype: str = "float32",
) -> None:
    """Write slabs (begin, end, values (end - begin, ny, nz)) of `slab_layers(grid)` layers as they come.

    `ambiguous_voxels` is called for the count after the last slab.
    """
    layers = min(slab_layers(grid), CHUNK, grid.shape[0])
    array = zarr.create_array(
        store=path,
        shape=grid.shape,
        chunks=(layers, min(CHUNK, grid.shape[1]), min(CHUNK, grid.shape[2])),
        dtype=dtype,
        # A flipped bit is an error when it is read, not a wrong distance.
        compressors=[ZstdCodec(level=0), Crc32cCodec()],
        # Zero would be a surface: where a chunk is lost, nothing is known.
        fill_value=float("nan"),
        dimension_names=["x", "y", "z"] if grid.is_axis_aligned else ["i", "j", "k"],
        config={"write_empty_chunks": True},
    )
    for begin, end, values in slabs:
        array[begin:end] = values if isinstance(values, np.ndarray) else values.detach().cpu().numpy()
        # Let go of this slab before the next one is computed.
        del values
    # Chunks have checksums of their own.
    array.attrs[KEY] = with_checksum(record(grid, ambiguous_voxels(), made_from, signs), NO_VALUES)


def read(path: Path) -> SDM:
    """Read a whole map. `zarr.open_array` reads parts."""
    array = _open(path)
    grid, count = _geometry(array, path)
    if array.shape != grid.shape:
        raise FormatError(f"{path} is damaged: it has the shape {array.shape}, and its record says {grid.shape}")
    # Zarr reads a chunk that is gone as the fill value, without a word.
    if lost := array.nchunks - array.nchunks_initialized:
        raise FormatError(f"{path} has lost {lost:,} of its {array.nchunks:,} chunks: copy or compute the map again")
    values = torch.from_numpy(np.asarray(array[:], dtype=np.float32))
    return SDM(values, grid, count, **sign_arguments(array.attrs.get(KEY)))


def read_grid(path: Path) -> Grid:
    """Read the geometry alone."""
    return _geometry(_open(path), path)[0]


def read_record(path: Path) -> Any:
    """Read what is kept beside the values."""
    return _open(path).attrs.get(KEY)


def _open(path: Path) -> zarr.Array:
    opened = zarr.open(path, mode="r")
    if not isinstance(opened, zarr.Array):
        dataset = "sdm" in opened.attrs and "theta" in opened
        what = "a dataset of maps: sdm explore shows it, and sdm.SDMDataset(path).sdm(number) is one of them"
        raise FormatError(f"{path} is {what if dataset else 'a zarr group; an array that sdm wrote is needed'}")
    return opened


def _geometry(array: zarr.Array, path: Path) -> tuple[Grid, int | None]:
    kept = array.attrs.get(KEY)
    verify(kept, NO_VALUES, str(path))
    return from_record(kept, str(path))
