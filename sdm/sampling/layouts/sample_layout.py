"""Interface of the layouts that samples are written in."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from torch import Tensor

from sdm.core.normalization import Normal
from sdm.sampling.law import SampleLaw
from sdm.sampling.layouts.instance import Instance
from sdm.sampling.sample import PointSamples


class Layout(Protocol):
    """A way to keep the samples of many meshes in a folder. Its methods may be called in any thread, but for `end`."""

    # What is sampled, if nobody says otherwise: the law, the normalisation, the number of samples, and whether normals
    # are needed.
    law: SampleLaw
    normalize: Normal
    count: int
    with_normals: bool

    def begin(self, folder: Path, instances: list[Instance], count: int) -> None:
        """Prepare a folder, which may hold samples of an earlier run of the same recipe."""
        ...

    @property
    def together(self) -> int:
        """Number of meshes, from a multiple of it on, that lie in one file, once the layout has begun."""
        ...

    def is_done(self, number: int) -> bool:
        """True if the samples of a mesh, by its number, are there.

        Raises:
            MeshError: They are not, and the file that they belong in was finished without them.
        """
        ...

    def write(self, number: int, samples: PointSamples) -> Path | None:
        """Keep the samples of a mesh: whole, or not at all. The file, if it has one of its own."""
        ...

    def failed(self, number: int) -> None:
        """Take notice of a mesh whose samples will not come."""
        ...

    def rounded(self, points: Tensor) -> Tensor:
        """Points (N,3) as the layout keeps them: what is measured."""
        ...

    def end(self, done: list[bool], parts: dict[str, list[int]]) -> None:
        """Complete the folder.

        Args:
            done: Of each mesh, whether its samples are there.
            parts: Part of the folder's split -> numbers of its meshes; none if there is no split.
        """
        ...
