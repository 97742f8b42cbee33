"""Tar files as WebDataset reads them, each with the samples of many meshes: `samples-000000.tar`, ...

Of each mesh `KEY.samples.npz` (points (N,3), distances (N,), and closest points and normals where they were wanted) and
`KEY.json` (path, class, instance, normalisation). The same samples make the same bytes. Of a tar file that was written
without some of its meshes, `samples-000000.left-out.lst` names these.
"""

from __future__ import annotations

import io
import json
import os
import tarfile
import threading
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from sdm.core.normalization import Normal
from sdm.errors import MeshError
from sdm.io.files.atomic import put, replacing
from sdm.io.files.stand_in import gone
from sdm.sampling.law import PAPER, SampleLaw
from sdm.sampling.layouts.instance import Instance, free_name
from sdm.sampling.sample import PointSamples

# Bytes of a tar file, about.
SHARD_BYTES = 1 << 28


class WebDatasetLayout:
    """See above. A tar file is written once all of its meshes are done."""

    law: SampleLaw = PAPER
    normalize: Normal = "sphere"
    count, with_normals = 500_000, False

    def begin(self, folder: Path, instances: list[Instance], count: int) -> None:
        """See `Layout`."""
        self._folder, self._instances = folder, instances
        self._each = max(1, min(len(instances), SHARD_BYTES // (16 * count)))
        self._lock = threading.Lock()
        self._waiting: dict[int, dict[int, list[tuple[str, bytes]]]] = {}
        self._there = {n for n in range(-(-len(instances) // self._each)) if self._file(n).is_file()}
        lists = (self._left_out(shard) for shard in self._there)
        self._lost = {
            path for found in lists if found.is_file() for path in os.fsdecode(found.read_bytes()).split("\n")
        }
        taken: set[str] = set()
        # A key ends at its first dot.
        self._keys = [free_name(f"{own.category}/{own.name}".replace(".", "_"), taken) for own in instances]

    @property
    def together(self) -> int:
        """See `Layout`: those of a tar file."""
        return self._each

    def is_done(self, number: int) -> bool:
        """See `Layout`. A mesh is lost with its tar file."""
        shard = number // self._each
        if shard in self._there and self._instances[number].path in self._lost:
            raise MeshError(
                f"{self._instances[number].path} could not be used when {self._file(shard)} was written without it: "
                "remove that file to make it again"
            )
        return shard in self._there

    def write(self, number: int, samples: PointSamples) -> Path | None:
        """See `Layout`."""
        return self._add(number, self._members(number, samples))

    def failed(self, number: int) -> None:
        """See `Layout`."""
        if number // self._each not in self._there:
            self._add(number, [])

    def rounded(self, points: Tensor) -> Tensor:
        """See `Layout`."""
        return points

    def end(self, done: list[bool], parts: dict[str, list[int]]) -> None:
        """See `Layout`."""
        names = "".join(
            f"{self._file(n).name}\n" for n in range(-(-len(done) // self._each)) if self._file(n).is_file()
        )
        put(self._folder / "shards.lst", names.encode())

    def _members(self, number: int, samples: PointSamples) -> list[tuple[str, bytes]]:
        instance = self._instances[number]
        arrays = {"points": samples.points, "distances": samples.distances}
        arrays |= {} if samples.closest is None else {"closest": samples.closest}
        arrays |= {} if samples.normals is None else {"normals": samples.normals}
        packed = io.BytesIO()
        contents: dict[str, Any] = {name: values.cpu().numpy() for name, values in arrays.items()}
        np.savez(packed, **contents)
        by = samples.normalization
        told = {
            "path": instance.path,
            "class": instance.category,
            "instance": instance.name,
            "normalization": None if by is None else {"kind": by.kind, "centre": by.centre, "length": by.length},
        }
        key = self._keys[number]
        return [(f"{key}.json", json.dumps(told).encode()), (f"{key}.samples.npz", packed.getvalue())]

    def _add(self, number: int, members: list[tuple[str, bytes]]) -> Path | None:
        shard = number // self._each
        size = min(self._each, len(self._instances) - shard * self._each)
        with self._lock:
            held = self._waiting.setdefault(shard, {})
            held[number] = members
            if len(held) < size:
                return None
            del self._waiting[shard]
        lost = "".join(f"{self._instances[number].path}\n" for number, own in sorted(held.items()) if not own)
        if lost:
            put(self._left_out(shard), os.fsencode(lost))
        with replacing(self._file(shard)) as part, tarfile.open(part, "w", format=tarfile.PAX_FORMAT) as tar:
            for _, own in sorted(held.items()):
                for name, content in own:
                    info = tarfile.TarInfo(name)
                    info.size, info.mode = len(content), 0o644
                    tar.addfile(info, io.BytesIO(content))
        if not lost:
            # Of a run before, in which something failed.
            self._left_out(shard).unlink(missing_ok=True)
            gone(self._left_out(shard))
        return self._file(shard)

    def _left_out(self, shard: int) -> Path:
        return self._folder / f"samples-{shard:06}.left-out.lst"

    def _file(self, shard: int) -> Path:
        return self._folder / f"samples-{shard:06}.tar"
