"""Reader of a dataset: random access for a DataLoader, item for item what the stream yields."""

from __future__ import annotations

import operator
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr
from torch import Tensor
from torch.utils.data import Dataset

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.dataset import layout
from sdm.dataset.manifest import read_manifest, require_draws
from sdm.dataset.shard_paths import file_of, rows_of
from sdm.errors import FormatError, SDMError, one_line
from sdm.io.files.remote import place_of
from sdm.shapes import Family, Parameter
from sdm.stream import Batch, SDMStream


class SDMDataset(Dataset[Batch]):
    """The samples of a dataset that `sdm generate` wrote.

    Args:
        path: The dataset, or its address, such as `s3://bucket/cochlea.zarr` (extra `remote`): each sample is then
            fetched as it is asked for.

    Attributes:
        manifest: What it was made from: family, seed, sampler, version, device, ...
        grid: Where all maps are measured.
        parameters: Name, range and unit of each column of theta.
        theta: (N,P) float32 parameters of all samples, on the host.

    `dataset[i]` is `Batch(theta (P,), sdm (1,nx,ny,nz), index ())` on the host, which a DataLoader stacks to the
    `Batch` that a stream with the same seed yields. Any number of workers and processes may read at a time.

    Raises:
        FormatError: It is no dataset, an unfinished one, or one that lost parameters.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = place_of(path)
        if not self.path.exists() and layout.part_of(self.path).exists():
            raise FormatError(f"{self.path} is not finished: sdm generate --resume finishes it")
        if self.path.name.endswith(layout.UNFINISHED):
            raise FormatError(f"{self.path} is not finished: sdm generate --resume finishes it")
        self.manifest: dict[str, Any] = read_manifest(self.path)
        self.grid = Grid(**self.manifest["recipe"]["grid"])
        self.parameters = tuple(Parameter(**p) for p in self.manifest["parameters"])
        self.theta = torch.from_numpy(self._rows("theta", range(layout.shard_count(self.manifest))).astype(np.float32))
        self._maps: zarr.Array | None = None
        self._process = os.getpid()

    def __len__(self) -> int:
        return self.manifest["count"]

    def __getitem__(self, item: int) -> Batch:
        number = self._number(item)
        try:
            values = self._array()[number]
        except FormatError:
            raise
        except (OSError, ValueError, RuntimeError, IndexError) as error:
            raise FormatError(
                f"sample {number} of {self.path} is damaged: sdm generate --verify makes it again ({one_line(error)})"
            ) from error
        return Batch(
            self.theta[number], torch.from_numpy(self._whole(values, number))[None], torch.tensor(number, device="cpu")
        )

    def sdm(self, item: int) -> SDM:
        """One sample as a map with its grid, float32."""
        return SDM(self[item].sdm[0].float(), self.grid)

    def inverse_transform(self, item: int) -> Tensor:
        """(4,4) float64 matrix from a sample's coordinates back to those of the mesh that it was made from.

        The identity for families whose shapes have no other coordinates. A smooth warp is not undone: points come to
        where they are on the warped mesh.
        """
        number = self._number(item)
        if not self.manifest["transforms"]:
            return torch.eye(4, dtype=torch.float64, device="cpu")
        shard, row = divmod(number, self.manifest["shard"])
        return torch.linalg.inv(torch.from_numpy(self._rows("transform", range(shard, shard + 1))[row]))

    def stream(self, family: Family | str | None = None, batch_size: int = 16, **options: Any) -> SDMStream:
        """The endless stream whose first samples are this dataset's, from its record.

        Args:
            family: The shapes, or their name. If not given, those of the record; code of yours, FILE.py:NAME, is run
                only where it is named here.
            batch_size: Samples of a batch on each rank.
            options: Of `SDMStream` but what the record says (grid, seed, sampler, dtype, truncate, sign, hole_size):
                `start=len(dataset)` goes on behind the last sample.

        Raises:
            SDMError: The record does not say the family, or another one was given: in one sentence.
        """
        from sdm.dataset.family_registry import family_of_manifest

        require_draws(self.manifest, self.path)
        recipe = self.manifest["recipe"]
        own = {key: recipe[key] for key in ("seed", "sampler", "truncate", "sign", "hole_size")}
        given = sorted({"grid", "dtype", *own} & options.keys())
        if given:
            raise SDMError(f"{given[0]} is as in the record of {self.path}: leave it out")
        shapes = family_of_manifest(self.manifest, family)
        return SDMStream(shapes, self.grid, batch_size, dtype=getattr(torch, recipe["dtype"]), **own, **options)

    def _number(self, item: int) -> int:
        try:
            number = operator.index(item)
        except TypeError:
            raise SDMError(
                f"{item!r} is no number of a sample: give one whole number, or torch.utils.data.Subset several"
            ) from None
        if not -len(self) <= number < len(self):
            raise IndexError(f"{self.path} has {len(self)} samples; there is no number {number}")
        return number % len(self)

    def _whole(self, values: Any, number: int) -> np.ndarray:
        found = np.array(values)
        # A file that is gone reads as the fill value.
        if np.isnan(found.flat[0]) and not layout.is_done(self.path, self.manifest, number // self.manifest["shard"]):
            raise SDMError(f"sample {number} of {self.path} is gone: sdm generate --verify makes it again")
        return found

    def _rows(self, name: str, shards: range) -> np.ndarray:
        """Rows of a small array that are in some shards."""
        mend = "sdm generate --verify makes it again"
        for number in shards:
            # A file that is gone reads as zeros, and a pose or a parameter may be zero.
            if not file_of(self.path, name, number).is_file():
                raise FormatError(f"{name} of shard {number} of {self.path} is gone: {mend}")
        begin, end = rows_of(self.manifest, shards[0])[0], rows_of(self.manifest, shards[-1])[1]
        try:
            return np.asarray(self._open(name)[begin:end])
        except FormatError:
            raise
        except (OSError, ValueError, RuntimeError, IndexError) as error:
            raise FormatError(f"{name} of {self.path} is damaged: {mend} ({one_line(error)})") from error

    def _open(self, name: str) -> zarr.Array:
        damage = f"{self.path} cannot be read: its array {name} is damaged; sdm generate --verify mends it"
        try:
            there = self.path / name
            array = zarr.open_array(there if isinstance(there, Path) else str(there), mode="r")
        except Exception as error:  # Zarr checks damaged metadata with whatever they lead to, such as divisions by 0.
            raise FormatError(f"{damage} ({one_line(error)})") from error
        # Of other sizes Zarr would read something else, or ask for any amount of memory.
        if (array.shape, array.chunks, array.shards) != layout.sizes_of(self.manifest, name):
            raise FormatError(f"{damage} (its sizes are not those of the manifest)")
        return array

    def _array(self) -> zarr.Array:
        # Open files and threads of a parent are not those of its children.
        if self._maps is None or self._process != os.getpid():
            self._maps, self._process = self._open("sdm"), os.getpid()
        return self._maps

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_maps": None}

    def __repr__(self) -> str:
        family, shape = self.manifest["recipe"]["family"], " x ".join(map(str, self.grid.shape))
        return f"SDMDataset({self.path.name}: {len(self):,} of {family}, {shape} voxels)"
