"""The layout of facebookresearch/DeepSDF, whose loader reads it unchanged.

- `SdfSamples/DATASET/CLASS/INSTANCE.npz`: `pos` and `neg`, (N,4) float32 each: x, y, z and the signed distance of the
  samples outside and inside, in the normalised unit;
- `NormalizationParameters/DATASET/CLASS/INSTANCE.npz`: `offset` (3,) and `scale`: normalised = (p + offset) * scale;
- `splits/all.json`: the instances that are there, as that code's splits name them; of a folder with a split also
  `splits/train.json` and the like.
"""

from __future__ import annotations

import json
from pathlib import Path

import torch
from torch import Tensor

from sdm.core.normalization import Normal
from sdm.io.files.atomic import put
from sdm.sampling.law import PAPER, SampleLaw
from sdm.sampling.layouts.instance import Instance, lists_of
from sdm.sampling.layouts.npz_file import write_npz
from sdm.sampling.sample import PointSamples

SAMPLES, NORMALIZATION, SPLITS = "SdfSamples", "NormalizationParameters", "splits"


class DeepSDFLayout:
    """See above.

    Args:
        dataset: The dataset's name in the paths.
    """

    law: SampleLaw = PAPER
    normalize: Normal = "sphere"
    count, with_normals, together = 500_000, False, 1

    def __init__(self, dataset: str) -> None:
        self._dataset = dataset

    def begin(self, folder: Path, instances: list[Instance], count: int) -> None:
        """See `Layout`."""
        self._folder, self._instances = folder, instances

    def is_done(self, number: int) -> bool:
        """See `Layout`."""
        return self._file(SAMPLES, number).is_file() and self._file(NORMALIZATION, number).is_file()

    def write(self, number: int, samples: PointSamples) -> Path:
        """See `Layout`."""
        by = samples.normalization
        centre, length = ((0.0, 0.0, 0.0), 1.0) if by is None else (by.centre, by.length)
        offset, scale = torch.tensor(centre, device="cpu").neg(), torch.tensor(1 / length, device="cpu")
        write_npz(self._file(NORMALIZATION, number), offset=offset.numpy(), scale=scale.numpy())
        rows = torch.cat([samples.points, samples.distances[:, None]], 1).cpu()
        inside = rows[:, 3] < 0
        path = self._file(SAMPLES, number)
        write_npz(path, pos=rows[~inside].numpy(), neg=rows[inside].numpy())
        return path

    def failed(self, number: int) -> None:
        """See `Layout`."""

    def rounded(self, points: Tensor) -> Tensor:
        """See `Layout`."""
        return points

    def end(self, done: list[bool], parts: dict[str, list[int]]) -> None:
        """See `Layout`."""
        for name, classes in lists_of(self._instances, done, parts).items():
            put(
                self._folder / SPLITS / f"{name}.json", (json.dumps({self._dataset: classes}, indent=1) + "\n").encode()
            )

    def _file(self, part: str, number: int) -> Path:
        instance = self._instances[number]
        return self._folder / part / self._dataset / instance.category / f"{instance.name}.npz"
