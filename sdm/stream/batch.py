"""Batch of a stream's step."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Batch(NamedTuple):
    """Shapes and their signed distance maps, negative inside, in the family's unit of length.

    Args:
        theta: (B,P) float32 parameters, on the device.
        sdm: (B,1,nx,ny,nz) maps, on the device; float32 unless another type was requested.
        index: (B,) int64 global numbers of the samples, on the host, where reading them waits for nothing.
    """

    theta: Tensor
    sdm: Tensor
    index: Tensor
