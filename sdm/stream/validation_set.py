"""A fixed set of samples, named by what is in it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator

import torch
from torch.utils.data import Dataset

from sdm.core.given_values import whole
from sdm.core.grid import Grid
from sdm.core.random import derive_seed
from sdm.errors import SDMError
from sdm.stream.batch import Batch
from sdm.stream.held_out_samples import held_out_samples
from sdm.stream.sample_maker import Maker
from sdm.stream.samplers import Table

# Samples that are looked at a time.
CHUNK = 16


class ValidationSet(Dataset[Batch]):
    """Samples that stay the same, on the device that made them.

    Args:
        maker: Makes them.
        count: Number of samples.

    They are uniform samples that are held out: no stream whose sampler is of this package gives their parameters, for
    any seed, nor does the maker's own. `len` and `[i]` give single samples, `batches` gives batches. Those of a folder
    of meshes are the same meshes in other poses, sizes and warps: to validate on meshes that training has not seen,
    make a family of their own.

    Raises:
        SDMError: No samples requested, or a family of too few different shapes.

    Attributes:
        theta: (N,P) float32 parameters.
        sdm: (N,1,nx,ny,nz) maps.
        index: (N,) int64, 0 to N-1, on the host.
        grid: Where the maps are measured.
        name: "val-" and the first 16 digits of the SHA-256 of what is in it: family, grid, parameters, every bit of
            every map. The same name means the same numbers; another kind of device may round otherwise, and then the
            name differs.
    """

    def __init__(self, maker: Maker, count: int) -> None:
        if not isinstance(maker, Maker):
            raise SDMError(f"an object of type {type(maker).__name__} makes no samples: give a Maker")
        if (size := whole(count, 1)) is None:
            raise SDMError(f"a validation set of {count!r} samples was requested; give at least 1")
        theta = held_out_samples(maker.family, size, derive_seed(maker.seed, "validation set"), maker.sampler)
        own = Maker(
            maker.family,
            maker.grid,
            sampler=Table(theta, shuffle=False),
            device=maker.device,
            dtype=maker.dtype,
            truncate=maker.truncate,
            sign=maker.signs.sign,
            hole_size=maker.signs.hole_size,
        )
        made = [own.make(numbers) for numbers in torch.arange(size, device="cpu").split(own.at_once)]
        self.theta, self.sdm, self.index = (torch.cat(parts) for parts in zip(*made, strict=True))
        self.grid: Grid = maker.grid
        recipe = {key: own.recipe[key] for key in ("family", "fingerprint", "grid", "dtype", "truncate")}
        digest = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode())
        digest.update(self.theta.cpu().numpy().tobytes())
        for part in self.sdm.split(CHUNK):
            # As plain bytes: NumPy has no bfloat16.
            digest.update(part.cpu().contiguous().view(torch.uint8).numpy().tobytes())
        self.name = f"val-{digest.hexdigest()[:16]}"

    def __len__(self) -> int:
        return self.theta.shape[0]

    def __getitem__(self, item: int) -> Batch:
        return Batch(self.theta[item], self.sdm[item], self.index[item])

    def batches(self, batch_size: int) -> Iterator[Batch]:
        """The set in batches, in order; the last one may be smaller."""
        for parts in zip(*(x.split(batch_size) for x in (self.theta, self.sdm, self.index)), strict=True):
            yield Batch(*parts)

    def __repr__(self) -> str:
        return f"ValidationSet({self.name}, {len(self)} samples)"
