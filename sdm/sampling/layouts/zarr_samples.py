"""Samples of all meshes in one Zarr group: `points` (M,N,3) and `distances` (M,N) float32, a chunk for each mesh.

Attributes `sdm`: names, and what each was normalised by. A mesh that could not be sampled has NaN.
"""

from __future__ import annotations

import json
import struct
import tempfile
from pathlib import Path

import google_crc32c
import numpy as np
import zarr
from torch import Tensor
from zarr.codecs import Crc32cCodec

from sdm.core.normalization import Normal
from sdm.io.files.atomic import put
from sdm.sampling.law import PAPER, SampleLaw
from sdm.sampling.layouts.instance import Instance
from sdm.sampling.sample import PointSamples

KEY = "sdm"


class ZarrLayout:
    """See above."""

    law: SampleLaw = PAPER
    normalize: Normal = "sphere"
    count, with_normals, together = 500_000, False, 1

    def begin(self, folder: Path, instances: list[Instance], count: int) -> None:
        """See `Layout`."""
        self._folder, self._instances = folder, instances
        if (folder / "zarr.json").is_file():
            return
        with tempfile.TemporaryDirectory() as place:
            fresh = Path(place)
            self._describe(fresh, count)
            # The group's own last: a restart goes by it.
            for name in ("points/zarr.json", "distances/zarr.json", "zarr.json"):
                put(folder / name, (fresh / name).read_bytes())

    def _describe(self, folder: Path, count: int) -> None:
        """Write the group and its arrays without a chunk."""
        number = len(self._instances)
        group = zarr.create_group(store=folder, attributes={KEY: {"names": [own.path for own in self._instances]}})
        for name, shape in (("points", (number, count, 3)), ("distances", (number, count))):
            group.create_array(
                name,
                shape=shape,
                chunks=(1, *shape[1:]),
                dtype="float32",
                compressors=[Crc32cCodec()],
                filters=None,
                fill_value=float("nan"),
                config={"write_empty_chunks": True},
            )

    def is_done(self, number: int) -> bool:
        """See `Layout`."""
        return self._chunk("points", number).is_file() and self._chunk("distances", number).is_file()

    def write(self, number: int, samples: PointSamples) -> Path:
        """See `Layout`."""
        by = samples.normalization
        place = self._folder / "normalization" / f"{number}.txt"
        put(place, ("" if by is None else str(by)).encode())
        for name, values in (("points", samples.points), ("distances", samples.distances)):
            content = values.cpu().numpy().astype("<f4").tobytes()
            put(self._chunk(name, number), content + struct.pack("<I", google_crc32c.value(content)))
        return self._chunk("distances", number)

    def failed(self, number: int) -> None:
        """See `Layout`."""

    def rounded(self, points: Tensor) -> Tensor:
        """See `Layout`."""
        return points

    def end(self, done: list[bool], parts: dict[str, list[int]]) -> None:
        """See `Layout`."""
        found = json.loads((self._folder / "zarr.json").read_text())
        places = [self._folder / "normalization" / f"{number}.txt" for number in range(len(done))]
        known = [place.read_text() if there else None for place, there in zip(places, done, strict=True)]
        found["attributes"][KEY].update(normalization=known, done=done, parts=parts)
        put(self._folder / "zarr.json", json.dumps(found, indent=1).encode())

    def _chunk(self, name: str, number: int) -> Path:
        return (self._folder / name / "c" / str(number)).joinpath(*["0"] * (2 if name == "points" else 1))


def read_zarr(folder: Path, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (N,3) and distances (N,) of a mesh."""
    group = zarr.open_group(folder, mode="r")
    return np.asarray(group["points"][number]), np.asarray(group["distances"][number])  # pyright: ignore[reportArgumentType, reportIndexIssue]
