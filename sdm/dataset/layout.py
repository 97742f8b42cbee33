"""Layout of a dataset on disk: a Zarr 3 group that any Zarr reader understands.

- `sdm` (N,nx,ny,nz): one chunk a sample, many chunks in a shard, each shard one file written at once;
- `theta` (N,P) float32: the parameters of each sample;
- `transform` (N,4,4) float64, for families that place meshes: from the mesh's own coordinates to the sample's;
- `sha256` (shards,32) bytes: of each shard's files, written after them: a shard is done when its checksum is there;
- the group's attribute `sdm`: the manifest.

Chunks of the first three end with a CRC32C, which Zarr checks as it reads them; `theta` and `transform` of version 1
had none.

While it is being made a dataset is called NAME.part; the last step gives it its name.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec

from sdm.dataset.manifest import KEY, sealed
from sdm.dataset.shard_file import blocksize_of
from sdm.dataset.shard_paths import checksum_file, files_of
from sdm.dataset.versions import WITH_CHECKSUMS
from sdm.errors import FormatError
from sdm.io.files.atomic import own_name, put
from sdm.io.files.stand_in import bring

UNFINISHED = ".part"
# Bytes of a shard before compression: large enough for disks, small enough to lose.
SHARD_BYTES = 1 << 28
DIGEST = 32


def part_of(path: Path) -> Path:
    """Path of an unfinished dataset.

    Raises:
        FormatError: The path ends without a name.
    """
    if not path.name:
        raise FormatError(f"{path} is no name for a dataset: give one, for example cochlea.zarr")
    return path.with_name(path.name + UNFINISHED)


def samples_of_a_shard(sample_bytes: int, count: int) -> int:
    """Samples of a shard, if nobody says how many."""
    return max(1, min(count, SHARD_BYTES // sample_bytes))


def create(folder: Path, manifest: dict[str, Any]) -> None:
    """Make an empty dataset in `folder`, which must not be there."""
    # Under another name until the manifest is whole, so that a kill leaves nothing that looks like a dataset; under one
    # of its own, since another process may begin the same.
    fresh = own_name(folder)
    try:
        _empty(fresh, manifest)
        fresh.rename(folder)
        bring(folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _empty(fresh: Path, manifest: dict[str, Any]) -> None:
    group = zarr.create_group(store=fresh, attributes={KEY: sealed(manifest)})
    count, shard = manifest["count"], manifest["shard"]
    shape = tuple(manifest["recipe"]["grid"]["shape"])
    _sdm_array(fresh / "sdm", count, shape, manifest)
    width = len(manifest["parameters"])
    _rows_array(fresh / "theta", (count, width), "float32", manifest)
    if manifest["transforms"]:
        _rows_array(fresh / "transform", (count, 4, 4), "float64", manifest)
    shards = -(-count // shard)
    group.create_array(
        "sha256",
        shape=(shards, DIGEST),
        chunks=(1, DIGEST),
        dtype="uint8",
        compressors=None,
        filters=None,
        config={"write_empty_chunks": True},
    )


def sizes_of(manifest: dict[str, Any], name: str) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...] | None]:
    """Shape, chunks and shards of an array of samples."""
    rows = {"sdm": tuple(manifest["recipe"]["grid"]["shape"]), "theta": (len(manifest["parameters"]),)}
    row = rows.get(name, (4, 4))
    whole = (manifest["shard"], *row)
    return (manifest["count"], *row), (1, *row) if name == "sdm" else whole, whole if name == "sdm" else None


def mend_arrays(folder: Path, manifest: dict[str, Any]) -> list[str]:
    """Write again what the arrays' own `zarr.json` must say, where it says something else; the arrays' names."""
    mended = []
    with tempfile.TemporaryDirectory() as place:
        fresh = Path(place) / "d"
        _empty(fresh, manifest)
        for name in sorted(path.parent.name for path in fresh.glob("*/zarr.json")):
            if _description(folder / name) != _description(fresh / name):
                put(folder / name / "zarr.json", (fresh / name / "zarr.json").read_bytes())
                mended.append(name)
    return mended


def _description(array: Path) -> dict[str, Any] | None:
    """Content of an array's `zarr.json`, None if it is gone or cannot be read."""
    try:
        # As Zarr understands it, since versions of Zarr write the same in different words.
        found = zarr.open_array(array, mode="r").metadata.to_dict()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError, ArithmeticError):
        return None
    # Notes of users are no damage.
    return json.loads(json.dumps({**found, "attributes": {}}, default=str))


def _rows_array(store: Path, shape: tuple[int, ...], dtype: str, manifest: dict[str, Any]) -> zarr.Array:
    """Rows of numbers, one for each sample."""
    return zarr.create_array(
        store=store,
        shape=shape,
        chunks=(manifest["shard"], *shape[1:]),
        dtype=dtype,
        compressors=[Crc32cCodec()] if manifest["version"] >= WITH_CHECKSUMS else None,
        filters=None,
        config={"write_empty_chunks": True},
    )


def _sdm_array(store: Path, rows: int, shape: tuple[int, ...], manifest: dict[str, Any]) -> zarr.Array:
    dtype = manifest["recipe"]["dtype"]
    size = np.dtype(dtype).itemsize
    block = blocksize_of(manifest)
    compress = [BloscCodec(cname="zstd", clevel=1, shuffle="shuffle", typesize=size, blocksize=block)]
    return zarr.create_array(
        store=store,
        shape=(rows, *shape),
        shards=(manifest["shard"], *shape),
        chunks=(1, *shape),
        dtype=dtype,
        serializer=BytesCodec(),
        # A damaged chunk is an error when it is read, not a wrong distance.
        compressors=[*(compress if manifest["compression"] == "zstd" else []), Crc32cCodec()],
        filters=None,
        # Zero would be a surface: where a chunk is lost, nothing is known.
        fill_value=float("nan"),
        dimension_names=["sample", "x", "y", "z"],
        config={"write_empty_chunks": True},
    )


def shard_count(manifest: dict[str, Any]) -> int:
    """Number of shards."""
    return -(-manifest["count"] // manifest["shard"])


def is_done(folder: Path, manifest: dict[str, Any], number: int) -> bool:
    """True if a shard was finished: a matter of names and sizes, not of what is in it."""
    mark = checksum_file(folder, number)
    return (
        mark.is_file()
        and mark.stat().st_size == DIGEST
        and all(f.is_file() and f.stat().st_size > 0 for f in files_of(folder, manifest, number))
    )


def is_sound(folder: Path, manifest: dict[str, Any], number: int) -> bool:
    """True if a shard's files are, byte for byte, what was written."""
    return (
        is_done(folder, manifest, number)
        and checksum(folder, manifest, number) == checksum_file(folder, number).read_bytes()
    )


def checksum(folder: Path, manifest: dict[str, Any], number: int) -> bytes:
    """SHA-256 over the files of a shard."""
    digest = hashlib.sha256()
    for path in files_of(folder, manifest, number):
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.digest()
