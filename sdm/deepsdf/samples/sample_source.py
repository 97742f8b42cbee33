"""Batches of samples: points and their signed distances, shape by shape."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from torch import Tensor


class Samples(NamedTuple):
    """Points (B,N,3) in the unit sphere's box, and signed distances (B,N), negative inside, in unit-sphere radii."""

    points: Tensor
    values: Tensor


class SampleSource(Protocol):
    """Source of samples for a training."""

    def __len__(self) -> int:
        """Number of shapes."""
        ...

    def sample(self, shapes: Tensor, points: int, *, seed: int = 0, step: int = 0) -> Samples:
        """`points` samples of each of `shapes` (B,) int64: a pure function of (seed, step, shape)."""
        ...
